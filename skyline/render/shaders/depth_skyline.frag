// The paper's skyline (section 3, Fig. 2): in each column of a depth image, from the top, the
// first pixel whose depth is not infinite.
//
// A pixel is covered when its centre is below the skyline, so the skyline lies between that
// centre and the next one up: the pixel's top edge, 2(row + 1)/W - 1, is the unbiased ordinate.
// Output: v, forward depth in metres, covered row (-1 where no pixel of the column is covered).
#version 330 core

uniform sampler2D inverse_depth;
uniform int size;   // W

out vec3 skyline;

void main() {
    int column = int(gl_FragCoord.x);
    int row = size - 1;
    float inverse = 0.0;
    while (row >= 0) {
        inverse = texelFetch(inverse_depth, ivec2(column, row), 0).r;
        if (inverse > 0.0) break;
        row--;
    }
    skyline = vec3(2.0 * float(row + 1) / float(size) - 1.0, 1.0 / inverse, float(row));
}
