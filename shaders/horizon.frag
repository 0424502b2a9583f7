// Skylines of many viewpoints in one heading, for OpenGL below 4.3: a fragment is a column, a row
// of the target is a view. The same march as horizon.comp, without first bounds from neighbours.
//
// What earlier windows of a large field left comes in as a texture.
#version 330 core
#extension GL_ARB_gpu_shader_fp64 : enable
#define PRECISE
#include "horizon_march.glsl"

uniform sampler2D eyes;           // three texels an eye, as struct Eye: the last is half empty
uniform int first_row;            // of the target, the first eye's
uniform sampler2D known;          // v and depth so far
uniform usampler2D known_flags;

layout(location = 0) out vec2 skyline;
layout(location = 1) out uint flags;

const uint TRUNCATED = 1u, HOLE = 2u;

void main() {
    ivec2 here = ivec2(gl_FragCoord.xy);
    vec4 first = texelFetch(eyes, ivec2(0, here.y - first_row), 0);
    vec4 second = texelFetch(eyes, ivec2(1, here.y - first_row), 0);
    vec4 third = texelFetch(eyes, ivec2(2, here.y - first_row), 0);
    face(Eye(ivec2(first.xy), first.zw, second.xy, second.zw, third.xy));
    skyline = texelFetch(known, here, 0).xy;
    flags = texelFetch(known_flags, here, 0).x;
    int s_first, s_last, bin;
    aim(here.x, bin);
    bool live = strips(s_first, s_last);
    int winner = NO_STRIP;
    float best = max((skyline.x - 1e-6 * abs(skyline.x)) * metres_per_strip, NOTHING);
    march_heights(live, bin, s_first, s_last, NO_STRIP, best, winner);
    Hit hit = Hit(REAL(NOTHING), REAL(1e30), 0, 0);
    resolve(winner, winner != NO_STRIP, hit);
    float v = float(hit.v), z = float(hit.z);
    float tan_here = v / metres_per_strip, z_here = z * metres_per_strip;
    bool higher = v > DATA && (tan_here > skyline.x
        || (tan_here == skyline.x && z_here < skyline.y));
    if (higher) {
        skyline = vec2(tan_here, z_here);
        flags = (flags & HOLE)
            | (triangle_there(winner, hit.line, hit.family, true) ? 0u : TRUNCATED);
    }
#ifdef HOLES
    if (over_hole(live, bin, s_first, s_last)) flags |= HOLE;
#endif
}
