// Skylines of many viewpoints in one heading: a lane is a column, and takes every LANES-th of its
// group's. What won its last column is the first bound for its next.
//
// With RAISE, results stay where an earlier window of a large field left higher ones.
#version 430
#define PRECISE precise
layout(local_size_x = LANES) in;
#include "horizon_march.glsl"

layout(std430, binding = 0) readonly buffer Eyes { Eye eyes[]; };
layout(std430, binding = 1) buffer Tans { float elevation_tan[]; };
layout(std430, binding = 2) buffer Depths { float depth_m[]; };
layout(std430, binding = 3) buffer Flags { uint flags[]; };

uniform int run;                  // columns a lane takes
uniform int first_eye;
uniform int first_row;            // of the results, the first eye's

const uint TRUNCATED = 1u, HOLE = 2u;

void main() {
    int groups = (width + LANES * run - 1) / (LANES * run);
    int group = int(gl_WorkGroupID.x);
    int index = first_eye + group / groups;
    int first = (group % groups) * LANES * run + int(gl_LocalInvocationID.x);
    face(eyes[index]);
    int row = first_row + index;
    int winner = NO_STRIP;
    for (int i = 0; i < run; ++i) {
        int q = first + i * LANES;
        int at = row * width + min(q, width - 1);
        int s_first, s_last, bin;
        aim(q, bin);
        bool live = strips(s_first, s_last);
        // First bounds: the leaf that won the last column, and what else is known, a little lowered
        // so that an equal crossing is still found.
        float known = NOTHING;
#ifdef RAISE
        float tan_before = elevation_tan[at], depth_before_m = depth_m[at];
        known = tan_before;
#endif
        int done = winner & ~1;
        float best = NOTHING;
        winner = NO_STRIP;
        leaf(done, s_first, s_last, best, winner);
        known = (known - 1e-6 * abs(known)) * metres_per_strip;
        winner = known > best ? NO_STRIP : winner;
        best = max(best, known);
        march_heights(live, bin, s_first, s_last, done, best, winner);
        Hit hit = Hit(REAL(NOTHING), REAL(1e30), 0, 0);
        resolve(winner, winner != NO_STRIP, hit);
        bool found = float(hit.v) > DATA;
        float tan_here = found ? float(hit.v) / metres_per_strip : NOTHING;
        float depth_here_m = found ? float(hit.z) * metres_per_strip : 0.0;
        uint flag_here = found && !triangle_there(winner, hit.line, hit.family, true) ? TRUNCATED : 0u;
#ifdef HOLES
        flag_here |= over_hole(live, bin, s_first, s_last) ? HOLE : 0u;
#endif
#ifdef RAISE
        bool higher = tan_here > tan_before
            || (tan_here == tan_before && depth_here_m < depth_before_m);
        tan_here = higher ? tan_here : tan_before;
        depth_here_m = higher ? depth_here_m : depth_before_m;
        uint flag = flags[at];
        flag_here = (higher ? flag_here & TRUNCATED : flag & TRUNCATED) | ((flag | flag_here) & HOLE);
#endif
        if (q < width) {
            elevation_tan[at] = tan_here;
            depth_m[at] = depth_here_m;
            flags[at] = flag_here;
        }
    }
}
