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
#ifdef SHELLS
uniform vec2 shell_m;             // the range of depth
uniform sampler2D sky;            // v and depth of the skyline
#endif

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
#ifdef SHELLS
    z_low = max(shell_m.x, NEAREST_M) / metres_per_strip;
    z_high = shell_m.y / metres_per_strip;
#endif
    bool live = strips(s_first, s_last);
    PLACE place = NO_PLACE;
    float best = skyline.x;
#ifdef SHELLS
    vec2 sky_here = texelFetch(sky, ivec2(gl_FragCoord.xy), 0).xy;
    best = max(best, surfacing_tan(sky_here.x, sky_here.y, shell_m.x));
#endif
    best = max((best - 1e-6 * abs(best)) * metres_per_strip, NOTHING);
    march_heights(live, bin, s_first, s_last, NO_STRIP, best, place);
#ifdef SHELLS
    float v = place < NO_PLACE ? best : NOTHING, z = place;
#else
    Hit hit = Hit(REAL(NOTHING), REAL(1e30), 0, 0);
    resolve(place, place != NO_PLACE, hit);
    float v = float(hit.v), z = float(hit.z);
#endif
    float tan_here = v / metres_per_strip, z_here = z * metres_per_strip;
    bool higher = v > DATA && (tan_here > skyline.x
        || (tan_here == skyline.x && z_here < skyline.y));
#ifdef SHELLS
    higher = higher && tan_here > surfacing_tan(sky_here.x, sky_here.y, z_here);
#endif
    if (higher) {
        skyline = vec2(tan_here, z_here);
#ifndef SHELLS
        flags = (flags & HOLE)
            | (triangle_there(place, hit.line, hit.family, true) ? 0u : TRUNCATED);
#endif
    }
#ifdef HOLES
    if (over_hole(live, bin, s_first, s_last)) flags |= HOLE;
#endif
}
