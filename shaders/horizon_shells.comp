// Skylines of many viewpoints in one heading within ranges of depth, the shells: a lane is a column,
// takes every LANES-th of its group's and all shells of each. What won a shell in its last column
// is the first bound for the next.
//
// The whole skyline is known already. A shell keeps what could rise over it for an eye displaced
// by reach_m. With RAISE, results stay where an earlier window of a large field left higher ones.
#version 430
#define PRECISE precise
layout(local_size_x = LANES) in;
#include "horizon_march.glsl"

layout(std430, binding = 0) readonly buffer Eyes { Eye eyes[]; };
layout(std430, binding = 1) buffer Tans { float elevation_tan[]; };
layout(std430, binding = 2) buffer Depths { float depth_m[]; };

uniform int run;                  // columns a lane takes
uniform int first_eye;
uniform int first_row;            // of the skylines, the first eye's
uniform int first_shell_row;      // of the results, the first eye's first shell's
uniform int rows_a_shell;
uniform int shells;               // at most SHELLS
uniform float shell_edges_m[SHELLS + 1];

void main() {
    int groups = (width + LANES * run - 1) / (LANES * run);
    int group = int(gl_WorkGroupID.x);
    int index = first_eye + group / groups;
    int first = (group % groups) * LANES * run + int(gl_LocalInvocationID.x);
    face(eyes[index]);
    int winners[SHELLS];
    for (int shell = 0; shell < SHELLS; ++shell) winners[shell] = NO_STRIP;
    for (int i = 0; i < run; ++i) {
        int q = first + i * LANES;
        int column = min(q, width - 1), bin;
        aim(q, bin);
        int sky = (first_row + index) * width + column;
        float sky_tan = elevation_tan[sky], sky_depth_m = depth_m[sky];
        for (int shell = 0; shell < shells; ++shell) {
            int at = (first_shell_row + shell * rows_a_shell + index) * width + column;
            float low_m = shell_edges_m[shell], high_m = shell_edges_m[shell + 1];
            z_low = max(low_m, NEAREST_M) / metres_per_strip;
            z_high = high_m / metres_per_strip;
            // The shell that holds the skyline is known already.
            bool holds_sky = sky_tan > DATA && sky_depth_m >= low_m && sky_depth_m < high_m;
            int s_first, s_last;
            bool live = strips(s_first, s_last) && !holds_sky;
            if (holds_sky) s_last = s_first - 1;
            // What must be exceeded, a little lowered so that an equal crossing is still found.
            float known = surfacing_tan(sky_tan, sky_depth_m, low_m);
#ifdef RAISE
            float tan_before = elevation_tan[at], depth_before_m = depth_m[at];
            known = max(known, tan_before);
#endif
            known = (known - 1e-6 * abs(known)) * metres_per_strip;
            int done = winners[shell];
            float best = max(NOTHING, known), z = NO_PLACE;
            leaf(done, s_first, s_last, best, z);
            march_heights(live, bin, s_first, s_last, done, best, z);
            bool found = z < NO_PLACE && best > DATA;
            if (!holds_sky) {
                winners[shell] = found ? (ip + int(ceil(z + float(fp))) - 1) & ~1 : NO_STRIP;
            }
            float tan_here = holds_sky ? sky_tan : found ? best / metres_per_strip : NOTHING;
            float depth_here_m = holds_sky ? sky_depth_m : found ? z * metres_per_strip : 0.0;
            if (tan_here <= surfacing_tan(sky_tan, sky_depth_m, depth_here_m)) tan_here = NOTHING;
#ifdef RAISE
            bool higher = tan_here > tan_before
                || (tan_here == tan_before && depth_here_m < depth_before_m);
            tan_here = higher ? tan_here : tan_before;
            depth_here_m = higher ? depth_here_m : depth_before_m;
#endif
            if (q < width) {
                elevation_tan[at] = tan_here;
                depth_m[at] = depth_here_m;
            }
        }
    }
}
