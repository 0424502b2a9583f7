// Inverse forward depth 1/z of the nearest surface in each pixel; 0 stays where depth is infinite.
//
// The target is 32-bit float and the greatest value wins (blend equation MAX). So 1/z keeps float
// precision, about 1e-7 of the distance, from the near plane to the horizon, without a depth buffer
// or a near-far trade-off.
#version 330 core

#ifdef HOLES
in float hole;
#endif
out float inverse_depth;

void main() {
#ifdef HOLES
    if (hole > 0.0) discard;
#endif
    inverse_depth = gl_FragCoord.w;
}
