// Height-field grid as seen by one 90 degree camera: the projection P = K[R|t] of paper 4.1.
//
// A tile is TILE x TILE cells; instance = tile, vertex id = sample within the tile. The sample's
// place relative to the eye is (whole cells - eye cell) - eye fraction, which is exact near the
// eye whatever the eastings are. Curvature and refraction are those of Curvature.drop_m:
// y -= drop_per_m2 * d^2.
#version 330 core

uniform sampler2D heights_m;
uniform ivec2 field_size;       // columns, rows
uniform vec2 spacing_m;         // east, north
uniform ivec2 eye_cell;         // column, row of the sample north-west of the eye
uniform vec2 eye_fraction;      // of a cell, east and south of that sample
uniform vec2 eye_elevation_m;   // high and low part of the float64 value
uniform float drop_per_m2;
uniform mat4 camera;            // east, up, south -> clip

in ivec2 tile_origin;           // column, row of the tile's north-west sample

#ifdef HOLES
out float hole;                 // above zero anywhere in a triangle that has a hole at a corner
#endif

void main() {
    ivec2 within = ivec2(gl_VertexID % (TILE + 1), gl_VertexID / (TILE + 1));
    ivec2 site = min(tile_origin + within, field_size - 1);
    float height = texelFetch(heights_m, site, 0).r;
#ifdef HOLES
    hole = height < HOLE_HEIGHT_M * 0.5 ? 1.0 : 0.0;
    if (hole > 0.0) height = eye_elevation_m.x;
#endif
    vec2 ground = (vec2(site - eye_cell) - eye_fraction) * spacing_m;  // east, south
    float up = (height - eye_elevation_m.x) - eye_elevation_m.y;
    up -= drop_per_m2 * dot(ground, ground);
    gl_Position = camera * vec4(ground.x, up, ground.y, 1.0);
}
