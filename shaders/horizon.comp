// Skylines of many viewpoints in one heading: a lane is a column, and takes every LANES-th of its
// group's. What won its last column is the first bound for its next.
//
// Results stay where an earlier window of a large field left higher ones.
#version 430
#define GATHER
#define PRECISE precise
layout(local_size_x = LANES) in;
#include "horizon_walk.glsl"

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
        bool live = aim(q, s_first, s_last, bin);
        // First bounds: the leaf that won the last column, and what an earlier window left, a
        // little lowered so that an equal crossing of this one is still found.
        int done = winner & ~1;
        float best = NOTHING;
        winner = NO_STRIP;
        leaf(done, s_first, s_last, best, winner);
        float known = elevation_tan[at] * metres_per_strip;
        known -= 1e-6 * abs(known);
        winner = known > best ? NO_STRIP : winner;
        best = max(best, known);
        walk_heights(live, bin, s_first, s_last, done, best, winner);
        Hit hit = Hit(REAL(NOTHING), REAL(1e30), 0, 0);
        resolve(winner, winner != NO_STRIP, hit);
        float v = float(hit.v);
        float tan_here = v / metres_per_strip, z_here = float(hit.z) * metres_per_strip;
        bool higher = v > DATA && (tan_here > elevation_tan[at]
            || (tan_here == elevation_tan[at] && z_here < depth_m[at]));
        bool border = !triangle_there(winner, hit.line, hit.family, true);
        uint flag = flags[at];
        flag = higher ? (flag & HOLE) | (border ? TRUNCATED : 0u) : flag;
#ifdef HOLES
        flag |= over_hole(live, bin, s_first, s_last) ? HOLE : 0u;
#endif
        if (q < width) {
            if (higher) elevation_tan[at] = tan_here;
            if (higher) depth_m[at] = z_here;
            flags[at] = flag;
        }
    }
}
