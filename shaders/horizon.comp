// Skylines of many viewpoints in one heading: each column marches forward over a tree of slabs and
// keeps the greatest v.
//
// The vertical half-plane of a column meets the surface's edges where its ground ray crosses rows,
// columns and diagonals of samples; the greatest v over these crossings is the skyline, as in the
// oracle of the benchmarks. Strips, one row of cells each, cut the field along the axis that the
// heading faces; the ray drifts sideways by k cells a strip. Slabs of 2, 16, 128, 1024 strips carry
// the greatest height that rays of their slope can meet (skyline/terrain/ray_mesh.py). A slab that
// cannot rise above the best crossing so far is passed over whole.
//
// Frame: p counts along the heading's axis and grows away from the eye (mirrored for north and
// west), w counts across it, to the east or south. Distances z are in strips. A crossing's y is
// metres above the eye, its v metres per strip; metres_per_strip scales both in the end. No
// coordinate is absolute: the eye is its nearest sample, in whole numbers, and an offset from it.
//
// Defines: HEADING 0..3; CELLS, how many cells of a strip a ray can cross; REAL, float or double;
// DANGLING where edges without triangles exist; HOLES to find the columns that look over one.
//
// A lane takes every LANES-th column of its group. The strip that won its last column gives the
// first bound for the next. With RAISE, higher results of an earlier window of a large field stay.
#version 430
layout(local_size_x = LANES) in;

struct Eye {
    ivec2 nearest;     // row, column of a sample
    vec2 offset;       // eye minus that sample, cells south and east, each in [-0.5, 0.5]
    vec2 offset_low;   // what float32 leaves of it
    vec2 elevation_m;  // high and low part
    vec2 turn_tan;     // tangent of the angle by which all columns are turned clockwise, in two parts
    ivec2 row;         // of the results; the second number is padding
};

layout(std430, binding = 0) readonly buffer Eyes { Eye eyes[]; };
layout(std430, binding = 1) buffer Tans { float elevation_tan[]; };
layout(std430, binding = 2) buffer Depths { float depth_m[]; };
layout(std430, binding = 3) buffer Flags { uint flags[]; };

uniform usampler2D present;       // 1 where there is a sample, also next to the window
uniform usampler2D slabs;         // the tree of heights: eight codes of 16 bits a texel
uniform sampler2D columns_m;      // the samples: a texel is a leaf's three of one column
uniform ivec2 columns_end;        // its last texel
uniform ivec2 samples;            // columns, rows of the window
uniform vec2 spacing_m;           // east, north
uniform float drop_per_m2;        // Curvature.drop_per_m2
uniform float slack_m;            // more than any rounding of y
uniform vec2 code_m;              // height of code 0 and of one step
uniform ivec3 levels[4];          // by level: first row in slabs, rows a bin, blocks before 0
#ifdef HOLES
uniform usampler2D rims;          // the tree of places where the surface may begin again: eight bits
uniform ivec3 rim_levels[4];
#endif
uniform int top_level;
uniform int bins;                 // of slopes, from -slope_max to slope_max
uniform float slope_max;
uniform sampler2D aims;           // by column: u, high and low part
uniform int width;
uniform int run;                  // columns a lane takes
uniform int first_eye;

const float NOTHING = -1e30;
const float DATA = -1e15;         // below every v, above every crossing with a hole
const float STRIP_SLACK = 1e-5;   // more than rounding of a distance, relative
const int COLUMN_APRON = 4;       // empty ones beside the samples, in columns_m
const int NO_STRIP = 0x7ffffff0;

const bool ALONG_COLUMNS = (HEADING & 1) == 1;             // strips are columns of cells
const bool FORWARD = HEADING == 1 || HEADING == 2;         // p grows with the sample's index
const int SIGN = FORWARD ? 1 : -1;

int ip, iw;                        // the eye's sample
REAL fp, fw, fd;                   // its offset, and where it stands among the diagonals
float eye_high_m, eye_low_m;
REAL turn_tan;
float metres_per_strip, metres_across;
vec3 sag_m;                        // drop of an edge's middle under its chord: row, lateral, diagonal
int w_first, w_last;               // cells of the window, relative to iw
int s_begin, s_end;                // strips of the window that lie ahead
REAL k, rate, inverse_k, inverse_rate;
float drop_per_strip2;
float z_enter, z_leave;            // distances between which the ray is beside cells of the window

struct Hit { REAL v, z; int line, family; };   // family: 0 row, 1 lateral, 2 diagonal

void face(Eye eye) {
    ivec2 at = ALONG_COLUMNS ? eye.nearest.yx : eye.nearest;
    REAL south = REAL(eye.offset.x) + REAL(eye.offset_low.x);
    REAL east = REAL(eye.offset.y) + REAL(eye.offset_low.y);
    ip = SIGN * at.x;
    iw = at.y;
    fp = REAL(SIGN) * (ALONG_COLUMNS ? east : south);
    fw = ALONG_COLUMNS ? south : east;
    // The first difference is exact where it is small.
    fd = (REAL(eye.offset.y) - REAL(eye.offset.x))
        + (REAL(eye.offset_low.y) - REAL(eye.offset_low.x));
    if (ALONG_COLUMNS) fd = -fd;
    eye_high_m = eye.elevation_m.x;
    eye_low_m = eye.elevation_m.y;
    turn_tan = REAL(eye.turn_tan.x) + REAL(eye.turn_tan.y);
    metres_per_strip = ALONG_COLUMNS ? spacing_m.x : spacing_m.y;
    metres_across = ALONG_COLUMNS ? spacing_m.y : spacing_m.x;
    float along2 = metres_per_strip * metres_per_strip, across2 = metres_across * metres_across;
    sag_m = drop_per_m2 * vec3(across2, along2, across2 + along2);
    ivec2 lines = ALONG_COLUMNS ? samples : samples.yx;
    w_first = -iw;
    w_last = lines.y - 2 - iw;
    s_begin = max(ip + int(floor(fp)), FORWARD ? 0 : 1 - lines.x);
    s_end = FORWARD ? lines.x - 1 : 0;
}

// Aim at column q; bin is the bin of its slope.
void aim(int q, out int bin) {
    vec2 own = texelFetch(aims, ivec2(min(q, width - 1), 0), 0).xy;
    REAL unturned = REAL(own.x) + REAL(own.y), shrunk = REAL(1) - unturned * turn_tan;
    REAL u = clamp((unturned + turn_tan) / shrunk, REAL(-1), REAL(1));
    k = REAL(HEADING < 2 ? 1 : -1) * u * REAL(metres_per_strip) / REAL(metres_across);
    rate = k - REAL(SIGN);
    inverse_k = REAL(1) / k;
    inverse_rate = REAL(1) / rate;
    drop_per_strip2 = drop_per_m2 * metres_per_strip * metres_per_strip * float(REAL(1) + u * u);
    float low = float(w_first) - float(fw), high = float(w_last + 1) - float(fw);
    float slope = float(k);
    z_enter = 0.0;
    z_leave = q < width ? 1e8 : -1.0;
    if (slope > 0.0) { z_enter = low / slope; z_leave = min(z_leave, high / slope); }
    if (slope < 0.0) { z_enter = high / slope; z_leave = min(z_leave, low / slope); }
    if (slope == 0.0 && (low > 0.0 || high < 0.0)) z_leave = -1.0;
    bin = int(floor((slope * float(SIGN) / slope_max + 1.0) * 0.5 * float(bins)));
    bin = clamp(bin, 0, bins - 1);
}

// The strips where the ray meets the window, rounded outwards; returns whether there are any.
bool strips(out int s_first, out int s_last) {
    float enter = clamp(z_enter, 0.0, 1e8);
    float leave = clamp(z_leave, -1.0, 1e8);
    s_first = max(s_begin, ip + int(floor(float(fp) + enter - STRIP_SLACK * (1.0 + enter))));
    s_last = min(s_end - 1, ip + int(floor(float(fp) + leave + STRIP_SLACK * (1.0 + leave))));
    bool meets = leave >= 0.0 && s_last >= s_first;
    if (!meets) s_last = s_first - 1;
    return meets;
}

bool sample_there(int p, int w) {
    ivec2 at = ALONG_COLUMNS ? ivec2(SIGN * p, iw + w) : ivec2(iw + w, SIGN * p);
    return texelFetch(present, clamp(at, ivec2(-1), samples) + 1, 0).x != 0u;
}

// Whether there is the third sample of the triangle beyond an edge crossed in strip s, or before it,
// seen from the eye. The edge has its own two.
bool triangle_there(int s, int line, int family, bool beyond) {
    bool right = beyond == (k > REAL(0));
    bool grows = beyond == (rate > REAL(0));
    int p = family == 0 ? (beyond ? s + 2 : s)
          : family == 1 ? s + (right == FORWARD ? 1 : 0)
          : s + (grows != FORWARD ? 1 : 0);
    int w = family == 0 ? line + (beyond == FORWARD ? 1 : 0)
          : family == 1 ? line + (right ? 1 : -1)
          : line + (grows ? 1 : 0);
    return sample_there(p, w);
}

// Whether an edge has both samples; a crossing at one of them does not show the other.
bool edge_there(int s, int line, int family) {
    ivec2 near = ivec2(family == 0 ? s + 1 : s, line + (family == 2 && !FORWARD ? 1 : 0));
    ivec2 far = ivec2(s + 1, line + (family == 0 || (family == 2 && FORWARD) ? 1 : 0));
    return sample_there(near.x, near.y) && sample_there(far.x, far.y);
}

// The three samples of column w on the lines of a leaf's strips, s and s + 1, relative to the eye.
vec3 column(int s, int w) {
    ivec2 at = ivec2(iw + w, FORWARD ? s >> 1 : -1 - (s >> 1)) + ivec2(COLUMN_APRON, 0);
    vec3 h = texelFetch(columns_m, clamp(at, ivec2(0), columns_end), 0).xyz - eye_high_m;
    return FORWARD ? h : h.zyx;
}

// v of a crossing at distance z, at fraction f between samples h0 and h1. Curvature applies to
// samples, and the edge between them is straight: hence the sag.
REAL crossing(float h0, float h1, REAL f, REAL z, float sag) {
    precise REAL y = (REAL(1) - f) * REAL(h0) + f * REAL(h1) - REAL(eye_low_m)
        - REAL(drop_per_strip2) * z * z - REAL(sag) * f * (REAL(1) - f);
    precise REAL v = y / z;
    return v;
}

// Whether a crossing raises the hit's v, or makes it v again.
bool counts(Hit hit, int s, REAL v, REAL line, int family, bool there) {
    there = there && v >= hit.v;
#ifdef DANGLING
    there = there && (triangle_there(s, int(line), family, true)
                      || triangle_there(s, int(line), family, false));
#endif
    return there;
}

void keep_v(inout Hit hit, int s, REAL v, REAL z, REAL line, int family, bool there) {
    hit.v = counts(hit, s, v, line, family, there) ? v : hit.v;
}

// Keep the whole hit, the nearest of equal ones.
void keep_all(inout Hit hit, int s, REAL v, REAL z, REAL line, int family, bool there) {
    if (counts(hit, s, v, line, family, there) && (v > hit.v || z < hit.z)) {
        hit = Hit(v, z, int(line), family);
    }
}

// Set the hit's v to 1 if the window's surface begins again at this crossing.
void keep_rim(inout Hit hit, int s, REAL v, REAL z, REAL line, int family, bool there) {
    there = there && line >= REAL(w_first) && line <= REAL(w_last + (family == 1 ? 1 : 0));
    if (there && edge_there(s, int(line), family) && !triangle_there(s, int(line), family, false)
        && triangle_there(s, int(line), family, true)) hit.v = REAL(1);
}

// Where the ray is on the near and far lines of strip s, and the greater of the cells there.
void span(int s, out REAL xn, out REAL xf, out int top) {
    xn = fw + k * max(REAL(s - ip) - fp, REAL(0));
    xf = fw + k * (REAL(s + 1 - ip) - fp);
    top = int(floor(clamp(max(xn, xf), REAL(w_first - 2), REAL(w_last + 2))));
}

// The crossings in strip s: lateral lines, diagonals, and the far row; the near row belongs to the
// strip before. h holds the near and far samples of columns top + 1 - CELLS to top + 1. There are
// no branches: both sides of one would be executed.
#define STRIP(NAME, KEEP)                                                                          \
void NAME(int s, bool on, REAL xn, REAL xf, int top, vec2 h[CELLS + 1], inout Hit hit) {           \
    REAL z0 = REAL(s - ip) - fp, zf = REAL(s + 1 - ip) - fp;                                       \
    REAL least = min(xn, xf), jf = floor(xf);                                                      \
    REAL diagonal = REAL(FORWARD ? ip - s : s + 1 - ip);                                           \
    vec2 far = vec2(0.0);                                                                          \
    for (int i = 0; i < CELLS; ++i) {                                                              \
        vec2 left = h[CELLS - 1 - i], right = h[CELLS - i];                                        \
        REAL line = REAL(top - i);                                                                 \
        far = i == 0 || line == jf ? vec2(left.y, right.y) : far;                                  \
        if (i < CELLS - 1) {                                                                       \
            REAL z = (line - fw) * inverse_k;                                                      \
            KEEP(hit, s, crossing(left.x, left.y, clamp(z - z0, REAL(0), REAL(1)), z, sag_m.y),    \
                 z, line, 1, on && line > least && z > REAL(0));                                   \
        }                                                                                          \
        REAL z = (line + diagonal - fd) * inverse_rate, f = z - z0;                                \
        float from = FORWARD ? left.x : right.x, to = FORWARD ? right.y : left.y;                  \
        KEEP(hit, s, crossing(from, to, f, z, sag_m.z), z, line, 2,                                \
             on && f >= REAL(0) && f <= REAL(1) && z > REAL(0));                                   \
    }                                                                                              \
    KEEP(hit, s, crossing(far.x, far.y, clamp(xf - jf, REAL(0), REAL(1)), zf, sag_m.x), zf, jf, 0, \
         on);                                                                                      \
}

STRIP(strip_best, keep_v)
STRIP(strip_all, keep_all)
STRIP(strip_rim, keep_rim)

// A single strip.
#define ALONE(NAME, STRIP_NAME)                                                                    \
void NAME(int s, bool on, inout Hit hit) {                                                         \
    REAL xn, xf;                                                                                   \
    int top;                                                                                       \
    span(s, xn, xf, top);                                                                          \
    vec2 h[CELLS + 1];                                                                             \
    for (int i = 0; i <= CELLS; ++i) {                                                             \
        vec3 three = column(s, top + 1 - CELLS + i);                                               \
        h[i] = (s & 1) == 0 ? three.xy : three.yz;                                                 \
    }                                                                                              \
    STRIP_NAME(s, on, xn, xf, top, h, hit);                                                        \
}

ALONE(resolve, strip_all)
ALONE(find_rim, strip_rim)

// Take the hit of strip s if it is higher than the best, or as high and nearer.
void raise(inout float best, inout int winner, Hit hit, int s) {
    float v = float(hit.v);
    bool take = v > best || (v == best && s < winner);
    winner = take ? s : winner;
    best = take ? v : best;
}

// The two strips of a leaf, s and s + 1.
void leaf(int s, int s_first, int s_last, inout float best, inout int winner) {
    Hit near = Hit(REAL(2.0 * NOTHING), REAL(1e30), 0, 0), far = near;
    REAL xn, xm, xf;
    int top_near, top_far;
    span(s, xn, xm, top_near);
    span(s + 1, xm, xf, top_far);
    vec3 three[CELLS + 1];
    vec2 h[CELLS + 1];
    for (int i = 0; i <= CELLS; ++i) {
        three[i] = column(s, top_near + 1 - CELLS + i);
        h[i] = three[i].xy;
    }
    strip_best(s, s >= s_first && s <= s_last, xn, xm, top_near, h, near);
#if CELLS == 2
    // The far strip needs one column more at most.
    top_far = clamp(top_far, top_near - 1, top_near + 1);
    bool left = top_far < top_near, right = top_far > top_near;
    vec2 fourth = column(s, left ? top_near - 2 : top_near + 2).yz;
    h[0] = left ? fourth : right ? three[1].yz : three[0].yz;
    h[1] = left ? three[0].yz : right ? three[2].yz : three[1].yz;
    h[2] = left ? three[1].yz : right ? fourth : three[2].yz;
#else
    for (int i = 0; i <= CELLS; ++i) h[i] = column(s, top_far + 1 - CELLS + i).yz;
#endif
    strip_best(s + 1, s + 1 >= s_first && s + 1 <= s_last, xm, xf, top_far, h, far);
    raise(best, winner, near, s);
    raise(best, winner, far, s + 1);
}

// The texel of the band that begins at strip s, for the block of columns where the ray crosses the
// band's line of least index.
ivec2 texel_of(ivec3 level, int s, int log_slab, int bin) {
    float slab = float(1 << log_slab);
    float z = float(s - ip) - float(fp) + (FORWARD ? 0.0 : 8.0 * slab);
    int within = iw & ((1 << log_slab) - 1);
    float blocks = floor((float(fw) + float(k) * z + float(within)) / slab);
    int node = s >> (log_slab + 3);
    return ivec2((iw >> log_slab) + int(clamp(blocks, -1e8, 1e8)) + level.z,
                 level.x + bin * level.y + (FORWARD ? node : -1 - node));
}

// The bits of a band's eight slabs that hold any of the strips s_first to s_last.
uint slabs_between(int s, int log_slab, int s_first, int s_last) {
    return (255u << uint(clamp((s_first - s) >> log_slab, 0, 8)))
        & (255u >> uint(clamp(7 - ((s_last - s) >> log_slab), 0, 8)));
}

// Which of a band's slabs of 2^log_slab strips can rise above the best so far. v is greatest at a
// slab's near end where y is positive, at its far end where it is negative.
uint higher_slabs(int s, int log_slab, int level, int bin, float best) {
    ivec2 at = texel_of(levels[level], s, log_slab, bin);
    if (at.x < 0 || at.x >= textureSize(slabs, 0).x) return 0u;
    uvec4 codes = texelFetch(slabs, at, 0);
    if (!FORWARD) { codes = codes.wzyx; codes = (codes >> 16) | (codes << 16); }
    float slab = float(1 << log_slab), z0 = float(s - ip) - float(fp);
    float base = code_m.x - (eye_high_m - slack_m);
    uint bits = 0u;
    float zn = max(z0, 0.0), best_n = best * zn;
#define SLAB(code, bit, i) {                                                                       \
        float zf = max(z0 + (i) * slab, 0.0), best_f = best * zf;                                  \
        float y = float(int(code)) * code_m.y + base - drop_per_strip2 * zn * zn;                  \
        bits |= y > min(best_n, best_f) ? bit : 0u;                                                \
        zn = zf; best_n = best_f; }
    SLAB(codes.x & 0xffffu, 1u, 1.0) SLAB(codes.x >> 16, 2u, 2.0)
    SLAB(codes.y & 0xffffu, 4u, 3.0) SLAB(codes.y >> 16, 8u, 4.0)
    SLAB(codes.z & 0xffffu, 16u, 5.0) SLAB(codes.z >> 16, 32u, 6.0)
    SLAB(codes.w & 0xffffu, 64u, 7.0) SLAB(codes.w >> 16, 128u, 8.0)
    return bits;
}

// The level of the band that holds all strips from s_first to s_last.
int start_level(int s_first, int s_last) {
    int apart = s_first ^ s_last;
    return min((apart >= 16 ? 1 : 0) + (apart >= 128 ? 1 : 0) + (apart >= 1024 ? 1 : 0), top_level);
}

// March over a tree, nearest slabs first. One word holds the slabs still to be opened, eight bits a
// level: its lowest bit is the deepest level's nearest slab. OPEN gives the slabs of a band that
// matter, LEAF looks at two strips.
#define MARCH(OPEN, LEAF)                                                                           \
    int top = start_level(s_first, s_last), s = (s_first >> (3 * top + 4)) << (3 * top + 4);       \
    uint todo = live ? OPEN(s, 3 * top + 1, top) << uint(8 * top) : 0u;                            \
    while (todo != 0u) {                                                                           \
        while (todo > 255u && (todo & 255u) == 0u) {                                               \
            int bit = findLSB(todo);                                                               \
            todo &= todo - 1u;                                                                     \
            int level = bit >> 3, log_size = 3 * level + 1;                                        \
            s = (((s >> (log_size + 3)) << 3) | (bit & 7)) << log_size;                            \
            todo |= OPEN(s, log_size - 3, level - 1) << uint(8 * level - 8);                       \
        }                                                                                          \
        while ((todo & 255u) != 0u) {                                                              \
            int bit = findLSB(todo);                                                               \
            todo &= todo - 1u;                                                                     \
            s = (s & ~15) | (bit << 1);                                                            \
            LEAF                                                                                   \
        }                                                                                          \
    }

// Raise best to the column's greatest v, without the leaf that is done already.
void march_heights(
    bool live, int bin, int s_first, int s_last, int done, inout float best, inout int winner
) {
#define OPEN(s, log_slab, level)                                                                   \
    (higher_slabs(s, log_slab, level, bin, best) & slabs_between(s, log_slab, s_first, s_last)     \
     & ~(level == 0 && ((s ^ done) & ~15) == 0 ? 1u << uint((done & 15) >> 1) : 0u))
    MARCH(OPEN, leaf(s, s_first, s_last, best, winner);)
#undef OPEN
}

#ifdef HOLES
uint marked_slabs(int s, int log_slab, int level, int bin) {
    ivec2 at = texel_of(rim_levels[level], s, log_slab, bin);
    if (at.x < 0 || at.x >= textureSize(rims, 0).x) return 0u;
    uint bits = texelFetch(rims, at, 0).x;
    if (FORWARD) return bits;
    bits = ((bits & 0xf0u) >> 4) | ((bits & 0x0fu) << 4);
    bits = ((bits & 0xccu) >> 2) | ((bits & 0x33u) << 2);
    return ((bits & 0xaau) >> 1) | ((bits & 0x55u) << 1);
}

// Whether the column leaves the surface and meets it again.
bool over_hole(bool live, int bin, int s_first, int s_last) {
    Hit rim = Hit(REAL(0), REAL(0), 0, 0);
#define OPEN(s, log_slab, level)                                                                   \
    (marked_slabs(s, log_slab, level, bin) & slabs_between(s, log_slab, s_first, s_last))
#define LEAF                                                                                       \
    find_rim(s, s >= s_first && s <= s_last, rim);                                                 \
    find_rim(s + 1, s + 1 >= s_first && s + 1 <= s_last, rim);                                     \
    if (rim.v > REAL(0)) todo = 0u;
    MARCH(OPEN, LEAF)
#undef OPEN
#undef LEAF
    return rim.v > REAL(0);
}
#endif

const uint TRUNCATED = 1u, HOLE = 2u;

void main() {
    int groups = (width + LANES * run - 1) / (LANES * run);
    int group = int(gl_WorkGroupID.x);
    int index = first_eye + group / groups;
    int first = (group % groups) * LANES * run + int(gl_LocalInvocationID.x);
    face(eyes[index]);
    int row = eyes[index].row.x;
    int winner = NO_STRIP;
    for (int i = 0; i < run; ++i) {
        int q = first + i * LANES;
        int at = row * width + min(q, width - 1);
        int s_first, s_last, bin;
        aim(q, bin);
        bool live = strips(s_first, s_last);
        // First bounds: the leaf that won the last column, and the result known, a little lowered
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
