/* jmplan.h: moves a mesh by a plan that jaxmorph exported. C99 and C++, no dependency.

   In one source file, before the include:  #define JMPLAN_IMPLEMENTATION

       jm_plan *plan = jm_open("wing.plan");
       if (jm_error(plan)) { puts(jm_error(plan)); return 1; }
       jm_deform(plan, u, points);                u (m, d) -> points (n, d)
       jm_pullback(plan, dJ_dpoints, dJ_du);      the transpose: (n, d) -> (m, d)
       jm_close(plan);

   Arrays are of doubles, row by row. A plan is never written to after jm_open: threads share it.
   MIT licence, as jaxmorph.

   The file, little-endian, in words of 64 bits. The header of 18 words: the bytes "JMPLAN\r\n",
   version 1, bytes of the file, two sums, d, n, m, the numbers of arrays, registers and steps, the
   first step that changes points, and the arrays of the points at rest, of the moving nodes, and of
   a layer's nodes (-1: none) with its two axes. The sums are over all words after them: of the
   words, and of the words times 1, 2, 3, and so on, modulo 2^64.
   Then a row for each array: kind (1 float64, 2 int64, 3 int32), count, offset in bytes; the rows
   of each register; nine words for each step: code, register that changes, register that is read
   (-1: none), five arrays (-1: none), a number. The arrays follow, each filled up to whole words.
   Register 0 is u, register 1 the points. A step adds a matrix times one register to another one,
   or solves or changes a register in place. The transpose runs the steps backwards. */
#ifndef JMPLAN_H
#define JMPLAN_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct jm_plan jm_plan;

jm_plan *jm_open(const char *path);          /* ask jm_error; to be closed also where that speaks */
const char *jm_error(const jm_plan *plan);   /* NULL if the plan can be used, else a sentence */
void jm_close(jm_plan *plan);

int64_t jm_dimension(const jm_plan *plan);   /* d: 2 or 3 */
int64_t jm_count(const jm_plan *plan);       /* n: points of this file */
int64_t jm_moving(const jm_plan *plan);      /* m: rows of u, of the whole mesh also in a part of it */
const double *jm_rest(const jm_plan *plan);  /* (n, d) points at u = 0 */
const int64_t *jm_nodes(const jm_plan *plan); /* (m) point of each row of u; -1 where another part has it */

/* Number of nodes of the mesh whose plane the plan is (one layer of cells), else 0. Node i of the
   mesh has the coordinates axes[0], axes[1] of point points[i]. */
int64_t jm_layer(const jm_plan *plan, const int32_t **points, int axes[2]);

/* All points, in parallel with OpenMP. 0, or 1 where memory is short. */
int jm_deform(const jm_plan *plan, const double *u, double *points);
int jm_pullback(const jm_plan *plan, const double *points_bar, double *u_bar);

/* The same for ranges of points: jm_fit once, jm_move for points first to first + count - 1, whose
   coordinates go to points[0] and on; then free(fit). jm_fit returns NULL where memory is short. */
double *jm_fit(const jm_plan *plan, const double *u);
void jm_move(const jm_plan *plan, const double *fit, int64_t first, int64_t count, double *points);

#ifdef __cplusplus
}
#endif
#endif /* JMPLAN_H */

#if defined(JMPLAN_IMPLEMENTATION) && !defined(JMPLAN_IMPLEMENTED)
#define JMPLAN_IMPLEMENTED

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(__GNUC__)
#define JM_INLINE static inline __attribute__((always_inline))
#else
#define JM_INLINE static inline
#endif

/* A plan is a program of linear steps. Each step reads one register, an array of rows of d
   numbers, and adds to another one, or changes one in place. Register 0 is u, register 1 are the
   points. Steps from `first` on change the points alone, row by row: any range of them. */
enum {
    JM_ADD = 1,      /* out += number * in */
    JM_SHIFT,        /* out += array 0 */
    JM_TAKE,         /* out[i] += in[array0[i]] */
    JM_PUT,          /* out[array0[k]] = in[array1[k]], array 0 ascending */
    JM_SPARSE,       /* out += A in; rows array 0, columns array 1, weights array 2 */
    JM_DENSE,        /* out += A in; array 0; `number` has the flags JM_FLAT, JM_TURNED, JM_MINUS */
    JM_CHOLESKY,     /* out = S (L L^T)^-1 S out; packed L array 0, S array 1; JM_FLAT */
    JM_LDL,          /* out = P^T (L D L^T)^-1 P out; packed L, diagonal and next diagonal of D, order: arrays 0 to 3 */
    JM_KERNEL,       /* out += radial functions at array 0; see jm_kernel */
    JM_MEAN,         /* out += means weighted by inverse distance; see jm_mean */
    JM_PLANE,        /* out[i] -= (out[i] n) n for i in array 0, ascending; n array 1 */
    JM_TURN,         /* out[i] = M out[i] for i in array 0, ascending; M array 1 */
    JM_PAIR,         /* out[b] = M out[a] = M (out[a] + M^T out[b]) / 2; a, b, M arrays 0 to 2 */
    JM_COPY,         /* out[b] = out[a] + shift; a, b, shift arrays 0 to 2, one after the other */
    JM_FORWARD       /* out[i] -= sum w out[j], rows i in the order of array 3; else as JM_SPARSE */
};
/* The components of all rows are one vector; by the transpose of A; out -= A in. */
enum { JM_FLAT = 1, JM_TURNED = 2, JM_MINUS = 4 };
enum { JM_REAL = 1, JM_LONG = 2, JM_INT = 3 };   /* kinds of arrays */
#define JM_HEAD 18    /* words of the header, and of a step */
#define JM_WORDS 9
#define JM_BLOCK 64   /* points in a loop, in a block of all steps, and parts of a sum over all points */
#define JM_ROWS 512
#define JM_PARTS 16

typedef struct jm_step { int64_t code, out, in, array[5], number; } jm_step;
typedef struct jm_table { int64_t kind, count, offset; } jm_table;

struct jm_plan {
    char message[192];
    char *memory;
    int64_t d, n, m, arrays, registers, steps, first, rest, nodes, layer, axes[2];
    const jm_table *table;
    const int64_t *rows;      /* of each register */
    const jm_step *step;
    int64_t *place;           /* of each register in the memory of jm_fit, in doubles; its length last */
};

static const double *jm_real(const jm_plan *q, int64_t a) { return (const double *)(const void *)(q->memory + q->table[a].offset); }
static const int32_t *jm_int(const jm_plan *q, int64_t a) { return (const int32_t *)(const void *)(q->memory + q->table[a].offset); }
static const int64_t *jm_long(const jm_plan *q, int64_t a) { return (const int64_t *)(const void *)(q->memory + q->table[a].offset); }
static int64_t jm_length(const jm_plan *q, int64_t a) { return q->table[a].count; }

/* ---------------------------------------------------------------- small pieces of linear algebra */

JM_INLINE double jm_dot(const double *a, const double *b, int64_t n) {
    double s[8] = {0, 0, 0, 0, 0, 0, 0, 0};
    int64_t i = 0;
    for (; i + 8 <= n; i += 8) for (int k = 0; k < 8; k++) s[k] += a[i + k] * b[i + k];
    for (; i < n; i++) s[0] += a[i] * b[i];
    return ((s[0] + s[4]) + (s[1] + s[5])) + ((s[2] + s[6]) + (s[3] + s[7]));
}

JM_INLINE void jm_axpy(double a, const double *x, double *y, int64_t n) { for (int64_t i = 0; i < n; i++) y[i] += a * x[i]; }

/* Rows of d numbers as d columns, and back. */
static void jm_columns(const double *rows, int64_t n, int64_t d, double *columns) {
    for (int64_t i = 0; i < n; i++) for (int64_t k = 0; k < d; k++) columns[k * n + i] = rows[i * d + k];
}
static void jm_add_columns(double factor, const double *columns, int64_t n, int64_t d, double *rows) {
    for (int64_t i = 0; i < n; i++) for (int64_t k = 0; k < d; k++) rows[i * d + k] += factor * columns[k * n + i];
}

/* y += A x, or A^T x, of A (r, c), for columns. */
static void jm_dense(const double *a, int64_t r, int64_t c, int64_t columns, const double *x, double *y, int turned) {
    for (int64_t i = 0; i < r; i++) for (int64_t k = 0; k < columns; k++) {
        if (turned) jm_axpy(x[k * r + i], a + i * c, y + k * c, c);
        else y[k * r + i] += jm_dot(a + i * c, x + k * c, c);
    }
}

static void jm_cholesky(const double *lower, const double *size, int64_t n, double *x) {
    const double *row = lower;
    for (int64_t i = 0; i < n; i++) x[i] *= size[i];
    for (int64_t i = 0; i < n; i++) { x[i] = (x[i] - jm_dot(row, x, i)) / row[i]; row += i + 1; }
    for (int64_t i = n - 1; i >= 0; i--) { row -= i + 1; x[i] /= row[i]; jm_axpy(-x[i], row, x, i); }
    for (int64_t i = 0; i < n; i++) x[i] *= size[i];
}

/* D has blocks of one and, where the next diagonal is not zero, of two rows. */
static void jm_ldl(const double *lower, const double *diagonal, const double *next, const int32_t *order, int64_t n, double *x, double *y) {
    const double *row = lower;
    for (int64_t i = 0; i < n; i++) { y[i] = x[order[i]] - jm_dot(row, y, i); row += i + 1; }
    for (int64_t i = 0; i < n; i++) {
        if (i + 1 < n && next[i] != 0) {
            const double a = diagonal[i] / next[i], b = diagonal[i + 1] / next[i], first = y[i], second = y[i + 1];
            y[i] = (b * first - second) / (a * b - 1) / next[i];
            y[i + 1] = (a * second - first) / (a * b - 1) / next[i];
            i++;
        }
        else y[i] /= diagonal[i];
    }
    for (int64_t i = n - 1; i >= 0; i--) { row -= i + 1; jm_axpy(-y[i], row, y, i); }
    for (int64_t i = 0; i < n; i++) x[order[i]] = y[i];
}

/* ---------------------------------------------------------------- radial functions */

enum { JM_THIN_PLATE, JM_LINEAR, JM_CUBIC, JM_GAUSSIAN, JM_MULTIQUADRIC, JM_INVERSE_MULTIQUADRIC, JM_INVERSE_QUADRATIC,
       JM_WENDLAND_C0, JM_WENDLAND_C2, JM_WENDLAND_C4, JM_WENDLAND_C6, JM_COMPACT_C0, JM_COMPACT_C1, JM_COMPACT_C2A,
       JM_COMPACT_C2B, JM_FUNCTIONS };

/* x log(x) / 2 of x >= 0 without a call or a branch, so that compilers make vectors of it: x = 2^k m
   with m from sqrt(1/2) to sqrt(2), log m = 2 artanh((m - 1) / (m + 1)). Three units in the last place. */
JM_INLINE double jm_thin_plate(double x) {
    static const uint64_t one = 0x3FF0000000000000u, half = 0x3FE6A09E00000000u;
    uint64_t bits, high;
    double k, m, s, z;
    memcpy(&bits, &x, 8);
    bits += one - half;
    high = (bits >> 52) | 0x4330000000000000u;
    bits = (bits & 0x000FFFFFFFFFFFFFu) + half;
    memcpy(&k, &high, 8);
    memcpy(&m, &bits, 8);
    k -= 4503599627370496.0 + 1023;
    s = (m - 1) / (m + 1);
    z = s * s;
    s *= 1 + z * (0.3333333333333335 + z * (0.199999999999497525 + z * (0.142857143129877435 + z * (0.1111110556739754
         + z * (0.090914445626308615 + z * (0.07665860800278021 + z * 0.07308224842521703))))));
    return x * (k * 0.34657359027997264 + s);
}

JM_INLINE double jm_compact(int kind, double xi) {
    double a = 1 - xi, b = a * a, l = kind > JM_COMPACT_C0 ? log(xi) : 0;
    if (xi >= 1) return 0;
    switch (kind) {
    case JM_WENDLAND_C0: return b;
    case JM_WENDLAND_C2: return b * b * (4 * xi + 1);
    case JM_WENDLAND_C4: return b * b * b * (xi * (35.0 / 3 * xi + 6) + 1);
    case JM_WENDLAND_C6: return b * b * b * b * (xi * (xi * (32 * xi + 25) + 8) + 1);
    case JM_COMPACT_C0: return b * b * a;
    case JM_COMPACT_C1: return 1 + xi * xi * (80.0 / 3 - 40 * xi + 15 * xi * xi - 8.0 / 3 * xi * xi * xi + 20 * l);
    case JM_COMPACT_C2A: return 1 - xi * xi * (30 + 10 * xi - 45 * xi * xi + 6 * xi * xi * xi + 60 * xi * l);
    default: return 1 - xi * xi * (20 - 80 * xi + 45 * xi * xi + 16 * xi * xi * xi - 60 * xi * xi * l);
    }
}

/* phi of squared distances, which are in units of the radius where there is one. */
JM_INLINE void jm_phi(int kind, double *r2, double *out) {
    int i;
    switch (kind) {
    case JM_THIN_PLATE: for (i = 0; i < JM_BLOCK; i++) out[i] = jm_thin_plate(r2[i]); break;
    case JM_LINEAR: for (i = 0; i < JM_BLOCK; i++) out[i] = sqrt(r2[i]); break;
    case JM_CUBIC: for (i = 0; i < JM_BLOCK; i++) out[i] = r2[i] * sqrt(r2[i]); break;
    case JM_GAUSSIAN: for (i = 0; i < JM_BLOCK; i++) out[i] = exp(-r2[i]); break;
    case JM_MULTIQUADRIC: for (i = 0; i < JM_BLOCK; i++) out[i] = sqrt(1 + r2[i]); break;
    case JM_INVERSE_MULTIQUADRIC: for (i = 0; i < JM_BLOCK; i++) out[i] = 1 / sqrt(1 + r2[i]); break;
    case JM_INVERSE_QUADRATIC: for (i = 0; i < JM_BLOCK; i++) out[i] = 1 / (1 + r2[i]); break;
    default: for (i = 0; i < JM_BLOCK; i++) out[i] = jm_compact(kind, sqrt(r2[i] + 4.930380657631324e-32));
    }
}

/* The field of radial functions and a polynomial at `count` points. Arrays of its step: points,
   sources (s, d) as columns, numbers (centre, scale, factor of squared distances), and a weight of each point or
   none. Register in: s rows of weights, then p rows of the polynomial. number: function + 256 p.
   Turned: adds the transpose of it to `weights`, from `values`. */
JM_INLINE void jm_kernel_of(int64_t d, int kind, int64_t s, int64_t p, const double *sources, const double *numbers,
                            const double *points, const double *shares, int64_t count, const double *coefficients,
                            double *values, double *bar) {
    const double scale = numbers[d], factor = numbers[d + 1];
    for (int64_t first = 0; first < count; first += JM_BLOCK) {
        const int64_t c = count - first < JM_BLOCK ? count - first : JM_BLOCK;
        double x[3][JM_BLOCK], y[3][JM_BLOCK], r2[JM_BLOCK], phi[JM_BLOCK];
        for (int64_t k = 0; k < d; k++) for (int64_t i = 0; i < JM_BLOCK; i++) {
            const int64_t at = first + (i < c ? i : c - 1);
            x[k][i] = (points[at * d + k] - numbers[k]) * scale;
            y[k][i] = bar && i < c ? values[at * d + k] * (shares ? shares[at] : 1) : 0;
        }
        for (int64_t j = 0; j < s; j++) {
            for (int i = 0; i < JM_BLOCK; i++) { double t = x[0][i] - sources[j]; r2[i] = t * t; }
            for (int64_t k = 1; k < d; k++) for (int i = 0; i < JM_BLOCK; i++) { double t = x[k][i] - sources[k * s + j]; r2[i] += t * t; }
            if (factor != 1) for (int i = 0; i < JM_BLOCK; i++) r2[i] *= factor;
            jm_phi(kind, r2, phi);
            for (int64_t k = 0; k < d; k++) {
                if (bar) bar[k * (s + p) + j] += jm_dot(phi, y[k], JM_BLOCK);
                else jm_axpy(coefficients[k * (s + p) + j], phi, y[k], JM_BLOCK);
            }
        }
        for (int64_t k = 0; k < d; k++) for (int64_t e = 0; e < p; e++) {
            if (!bar) for (int i = 0; i < JM_BLOCK; i++) y[k][i] += coefficients[k * (s + p) + s + e] * (e ? x[e - 1][i] : 1);
            else for (int i = 0; i < c; i++) bar[k * (s + p) + s + e] += y[k][i] * (e ? x[e - 1][i] : 1);
        }
        if (!bar) for (int64_t i = 0; i < c; i++) for (int64_t k = 0; k < d; k++)
            values[(first + i) * d + k] += y[k][i] * (shares ? shares[first + i] : 1);
    }
}

/* Loops with constants for the two dimensions and for the usual functions. */
#define JM_KERNEL_OF(kind)                                                                                            \
    if (d == 2) jm_kernel_of(2, kind, s, p, sources, numbers, points, shares, count, coefficients, values, bar);      \
    else jm_kernel_of(3, kind, s, p, sources, numbers, points, shares, count, coefficients, values, bar)
#define JM_KERNEL_BODY                                                                                                \
    switch (kind) {                                                                                                   \
    case JM_THIN_PLATE: JM_KERNEL_OF(JM_THIN_PLATE); break;                                                           \
    case JM_LINEAR: JM_KERNEL_OF(JM_LINEAR); break;                                                                   \
    case JM_WENDLAND_C2: JM_KERNEL_OF(JM_WENDLAND_C2); break;                                                         \
    default: JM_KERNEL_OF(kind);                                                                                      \
    }
#define JM_KERNEL_ARGUMENTS                                                                                           \
    int64_t d, int kind, int64_t s, int64_t p, const double *sources, const double *numbers, const double *points,    \
        const double *shares, int64_t count, const double *coefficients, double *values, double *bar

#define JM_KERNEL_NAMES d, kind, s, p, sources, numbers, points, shares, count, coefficients, values, bar

static void jm_kernel_plain(JM_KERNEL_ARGUMENTS) { JM_KERNEL_BODY }
#if defined(__GNUC__) && defined(__x86_64__) && !defined(__AVX512F__)
/* Whatever the flags of the compiler: the vectors that this machine has. */
__attribute__((target("avx2,fma"))) static void jm_kernel_4(JM_KERNEL_ARGUMENTS) { JM_KERNEL_BODY }
__attribute__((target("avx2,fma,avx512f,avx512dq,avx512vl"))) static void jm_kernel_8(JM_KERNEL_ARGUMENTS) { JM_KERNEL_BODY }
static void jm_kernel(JM_KERNEL_ARGUMENTS) {
    const int has_4 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
    const int has_8 = has_4 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
    (has_8 ? jm_kernel_8 : has_4 ? jm_kernel_4 : jm_kernel_plain)(JM_KERNEL_NAMES);
}
#else
#define jm_kernel jm_kernel_plain
#endif

static double jm_power(double squared, double exponent) {
    if (exponent != floor(exponent) || exponent > 64) return pow(squared, exponent / 2);
    double result = 1;
    for (int k = 0; k < (int)exponent / 2; k++) result *= squared;
    return (int)exponent % 2 ? result * sqrt(squared) : result;
}

JM_INLINE double jm_squared(int64_t d, const double *a, const double *b, double least) {
    double r2 = 0;
    for (int64_t k = 0; k < d; k++) r2 += (a[k] - b[k]) * (a[k] - b[k]);
    return r2 > least ? r2 : least;
}

/* Means weighted by areas A_j ((L/r)^far + (alpha L/r)^near). Arrays: points, surface nodes, numbers (far, near, alpha,
   L, bound of (L/r)^2, least r^2), shares of points or none, areas. */
static void jm_mean(int64_t d, const double *points, const double *nodes, const double *numbers, const double *shares,
                    const double *areas, int64_t count, int64_t b, const double *u, double *values, double *bar) {
    const double far = numbers[0], near = numbers[1], length = numbers[3] * numbers[3];
    for (int64_t i = 0; i < count; i++) {
        double least = HUGE_VAL, sum = 0, local, v[3] = {0, 0, 0};
        for (int64_t j = 0; j < b; j++) {
            const double r2 = jm_squared(d, points + i * d, nodes + j * d, numbers[5]);
            if (r2 < least) least = r2;
        }
        local = length / least;
        local = pow(numbers[2], near) * pow(local < numbers[4] ? local : numbers[4], (near - far) / 2);
        for (int pass = 0; pass < (bar ? 2 : 1); pass++) for (int64_t j = 0; j < b; j++) {
            const double ratio = least / jm_squared(d, points + i * d, nodes + j * d, numbers[5]);
            const double weight = areas[j] * (jm_power(ratio, far) + local * jm_power(ratio, near));
            if (!pass) sum += weight;
            for (int64_t k = 0; k < d; k++) {
                if (pass) bar[j * d + k] += weight / sum * (shares ? shares[i] : 1) * values[i * d + k];
                else if (!bar) v[k] += weight * u[j * d + k];
            }
        }
        if (!bar) for (int64_t k = 0; k < d; k++) values[i * d + k] += v[k] / sum * (shares ? shares[i] : 1);
    }
}

/* ---------------------------------------------------------------- steps, forward and turned */

static int64_t jm_lower_bound(const int32_t *rows, int64_t count, int64_t row) {
    int64_t low = 0, high = count;
    while (low < high) { int64_t middle = low + (high - low) / 2; if (rows[middle] < row) low = middle + 1; else high = middle; }
    return low;
}

JM_INLINE void jm_sparse(int64_t d, const int64_t *start, const int32_t *entry, const double *weight, int64_t first, int64_t last,
                         const double *in, double *out, double *bar) {
    for (int64_t i = first; i < last; i++) {
        double s[3] = {0, 0, 0};
        double *row = out + (i - first) * d;
        if (bar) for (int64_t e = start[i]; e < start[i + 1]; e++) for (int64_t k = 0; k < d; k++) bar[entry[e] * d + k] += weight[e] * row[k];
        else {
            for (int64_t e = start[i]; e < start[i + 1]; e++) for (int64_t k = 0; k < d; k++) s[k] += weight[e] * in[entry[e] * d + k];
            for (int64_t k = 0; k < d; k++) row[k] += s[k];
        }
    }
}

static void jm_matrix(const double *m, int64_t d, int turned, double *x) {
    double y[3] = {0, 0, 0};
    for (int64_t a = 0; a < d; a++) for (int64_t c = 0; c < d; c++) y[a] += (turned ? m[c * d + a] : m[a * d + c]) * x[c];
    for (int64_t a = 0; a < d; a++) x[a] = y[a];
}

/* A product, on columns; turned, its transpose. Returns 1 without memory. */
static int jm_product(const jm_plan *q, const jm_step *s, const double *source, double *target, int turned) {
    const int64_t d = q->d, flat = s->number & JM_FLAT, columns = flat ? 1 : d;
    const int64_t there = turned ? s->in : s->out, here = turned ? s->out : s->in;
    const int64_t r = q->rows[there], c = q->rows[here], tall = flat ? r * d : r, wide = flat ? c * d : c;
    double *to = (double *)calloc((size_t)((r + c) * d + 1), sizeof(double)), *from = to + r * d;
    if (!to) return 1;
    jm_columns(source, c, d, from);
    if (!turned == !(s->number & JM_TURNED)) jm_dense(jm_real(q, s->array[0]), tall, wide, columns, from, to, 0);
    else jm_dense(jm_real(q, s->array[0]), wide, tall, columns, from, to, 1);
    jm_add_columns(s->number & JM_MINUS ? -1 : 1, to, r, d, target);
    free(to);
    return 0;
}

/* A solve in place, on columns: symmetric, so its own transpose. Returns 1 without memory. */
static int jm_solve(const jm_plan *q, const jm_step *s, double *out) {
    const int64_t d = q->d, r = q->rows[s->out], flat = s->number & JM_FLAT, tall = flat ? r * d : r;
    double *x = (double *)malloc((size_t)(r * (d + 1) + 1) * sizeof(double));
    if (!x) return 1;
    jm_columns(out, r, d, x);
    for (int64_t k = 0; k < (flat ? 1 : d); k++) {
        if (s->code == JM_CHOLESKY) jm_cholesky(jm_real(q, s->array[0]), jm_real(q, s->array[1]), tall, x + k * tall);
        else jm_ldl(jm_real(q, s->array[0]), jm_real(q, s->array[1]), jm_real(q, s->array[2]), jm_int(q, s->array[3]), r, x + k * r, x + r * d);
    }
    memset(out, 0, (size_t)(r * d) * sizeof(double));
    jm_add_columns(1, x, r, d, out);
    free(x);
    return 0;
}

static void jm_forward(const jm_plan *q, const jm_step *s, double *out, int turned) {
    const int64_t d = q->d, r = q->rows[s->out];
    const int64_t *start = jm_long(q, s->array[0]);
    const int32_t *entry = jm_int(q, s->array[1]), *order = jm_int(q, s->array[3]);
    const double *weight = jm_real(q, s->array[2]);
    for (int64_t l = 0; l < r; l++) {
        const int64_t i = order[turned ? r - 1 - l : l];
        for (int64_t e = start[i]; e < start[i + 1]; e++) for (int64_t k = 0; k < d; k++) {
            if (turned) out[entry[e] * d + k] -= weight[e] * out[i * d + k];
            else out[i * d + k] -= weight[e] * out[entry[e] * d + k];
        }
    }
}

static void jm_pair(const jm_plan *q, const jm_step *s, double *out, int turned) {
    const int64_t d = q->d;
    const double *m = jm_real(q, s->array[2]);
    for (int64_t k = 0; k < jm_length(q, s->array[0]); k++) {
        double *a = out + (int64_t)jm_int(q, s->array[0])[k] * d, *b = out + (int64_t)jm_int(q, s->array[1])[k] * d, z[3] = {0, 0, 0};
        if (s->code == JM_COPY) for (int64_t c = 0; c < d; c++) {
            if (turned) { a[c] += b[c]; b[c] = 0; } else b[c] = a[c] + m[c];
        }
        else {
            memcpy(z, b, (size_t)d * sizeof(double));
            jm_matrix(m, d, 1, z);   /* the step is symmetric: it is its own transpose */
            for (int64_t c = 0; c < d; c++) a[c] = z[c] = (a[c] + z[c]) / 2;
            jm_matrix(m, d, 0, z);
            memcpy(b, z, (size_t)d * sizeof(double));
        }
    }
}

/* Changes of chosen rows of the range in place, or from `in`; turned with `bar`, the transpose of the same. */
static void jm_rows(const jm_plan *q, const jm_step *s, int64_t first, int64_t last, const double *in, double *out, double *bar, int turned) {
    const int64_t d = q->d, count = jm_length(q, s->array[0]);
    const int32_t *rows = jm_int(q, s->array[0]);
    for (int64_t k = jm_lower_bound(rows, count, first); k < count && rows[k] < last; k++) {
        double *z = out + (rows[k] - first) * d;
        if (s->code == JM_PUT) for (int64_t c = 0; c < d; c++) {
            const int64_t at = (int64_t)jm_int(q, s->array[1])[k] * d + c;
            if (turned) { bar[at] += z[c]; z[c] = 0; } else z[c] = in[at];
        }
        else if (s->code == JM_TURN) jm_matrix(jm_real(q, s->array[1]), d, turned, z);
        else {
            const double *normal = jm_real(q, s->array[1]);
            double along = 0;
            for (int64_t c = 0; c < d; c++) along += z[c] * normal[c];
            for (int64_t c = 0; c < d; c++) z[c] -= along * normal[c];
        }
    }
}

/* The field of a step in rows first to last; `columns` are the coefficients, or their cotangents, as columns. */
static void jm_field(const jm_plan *q, const jm_step *s, int64_t first, int64_t last, const double *in, double *out, double *bar) {
    const int64_t d = q->d;
    const double *points = jm_real(q, s->array[0]) + first * d, *shares = s->array[3] < 0 ? NULL : jm_real(q, s->array[3]) + first;
    const double *sources = jm_real(q, s->array[1]), *numbers = jm_real(q, s->array[2]);
    const int64_t rows = q->rows[s->in], p = s->number / 256;
    if (s->code == JM_KERNEL) jm_kernel(d, (int)(s->number % 256), rows - p, p, sources, numbers, points, shares, last - first, in, out, bar);
    else jm_mean(d, points, sources, numbers, shares, jm_real(q, s->array[4]), last - first, rows, in, out, bar);
}

/* One step for rows first to last of its register. `in` is the register that it reads: as columns for JM_KERNEL.
   Turned: takes the cotangent `out`, which it may change, and adds to the cotangent `bar` of the other register. */
static int jm_apply(const jm_plan *q, const jm_step *s, int64_t first, int64_t last, const double *in, double *out, double *bar, int turned) {
    const int64_t d = q->d, n = (last - first) * d;
    const int32_t *from;
    switch (s->code) {
    case JM_ADD:
        if (turned) jm_axpy((double)s->number, out, bar + first * d, n);
        else jm_axpy((double)s->number, in + first * d, out, n);
        return 0;
    case JM_SHIFT: if (!turned) jm_axpy(1, jm_real(q, s->array[0]) + first * d, out, n); return 0;
    case JM_TAKE:
        from = jm_int(q, s->array[0]);
        for (int64_t i = first; i < last; i++) for (int64_t k = 0; k < d; k++) {
            if (turned) bar[from[i] * d + k] += out[(i - first) * d + k];
            else out[(i - first) * d + k] += in[from[i] * d + k];
        }
        return 0;
    case JM_SPARSE:
        if (d == 2) jm_sparse(2, jm_long(q, s->array[0]), jm_int(q, s->array[1]), jm_real(q, s->array[2]), first, last, in, out, bar);
        else jm_sparse(3, jm_long(q, s->array[0]), jm_int(q, s->array[1]), jm_real(q, s->array[2]), first, last, in, out, bar);
        return 0;
    case JM_KERNEL: case JM_MEAN: jm_field(q, s, first, last, in, out, bar); return 0;
    case JM_PUT: case JM_PLANE: case JM_TURN: jm_rows(q, s, first, last, in, out, bar, turned); return 0;
    case JM_PAIR: case JM_COPY: jm_pair(q, s, out, turned); return 0;
    case JM_FORWARD: jm_forward(q, s, out, turned); return 0;
    case JM_DENSE: return jm_product(q, s, turned ? out : in, turned ? bar : out, turned);
    default: return jm_solve(q, s, out);
    }
}

/* ---------------------------------------------------------------- opening */

static jm_plan *jm_fail(jm_plan *q, const char *message) {
    snprintf(q->message, sizeof q->message, "%s", message);
    return q;
}

static int jm_has(const jm_plan *q, int64_t a, int64_t kind, int64_t count) {
    return a >= 0 && a < q->arrays && q->table[a].kind == kind && (count < 0 || q->table[a].count == count);
}

/* Whether an array holds `count` rows (any number if negative) between 0 and limit - 1, ascending if asked. */
static int jm_ids(const jm_plan *q, int64_t a, int64_t count, int64_t limit, int ascending) {
    if (!jm_has(q, a, JM_INT, count)) return 0;
    for (int64_t k = 0; k < jm_length(q, a); k++) {
        const int32_t row = jm_int(q, a)[k];
        if (row < 0 || row >= limit || (ascending && k && row <= jm_int(q, a)[k - 1])) return 0;
    }
    return 1;
}

static int jm_is_sparse(const jm_plan *q, const jm_step *s, int64_t rows, int64_t columns) {
    const int64_t *start;
    if (!jm_has(q, s->array[0], JM_LONG, rows + 1) || !jm_ids(q, s->array[1], -1, columns, 0)) return 0;
    if (!jm_has(q, s->array[2], JM_REAL, jm_length(q, s->array[1]))) return 0;
    start = jm_long(q, s->array[0]);
    for (int64_t i = 0; i < rows; i++) if (start[i] > start[i + 1]) return 0;
    return start[0] == 0 && start[rows] == jm_length(q, s->array[1]);
}

/* Whether an array has a times b numbers; the product of two counts of a file never overflows. */
static int jm_is_matrix(const jm_plan *q, int64_t array, int64_t a, int64_t b) {
    if (!jm_has(q, array, JM_REAL, -1)) return 0;
    return a < 1 || b < 1 ? jm_length(q, array) == 0 : jm_length(q, array) / a == b && jm_length(q, array) % a == 0;
}

/* Whether an array is a packed triangle of n rows. */
static int jm_is_packed(const jm_plan *q, int64_t array, int64_t n) {
    return n < 2000000000 && jm_has(q, array, JM_REAL, n * (n + 1) / 2);
}

static int jm_is_pair(const jm_plan *q, const jm_step *s, int64_t r) {
    return jm_ids(q, s->array[0], -1, r, 0) && jm_ids(q, s->array[1], jm_length(q, s->array[0]), r, 0)
           && jm_has(q, s->array[2], JM_REAL, s->code == JM_COPY ? q->d : q->d * q->d);
}

static int jm_is_field(const jm_plan *q, const jm_step *s, int64_t r, int64_t c) {
    const int64_t d = q->d, p = s->number / 256;
    if (!jm_has(q, s->array[0], JM_REAL, r * d) || (s->array[3] != -1 && !jm_has(q, s->array[3], JM_REAL, r))) return 0;
    if (s->code == JM_MEAN)
        return jm_has(q, s->array[1], JM_REAL, c * d) && jm_has(q, s->array[2], JM_REAL, 6) && jm_has(q, s->array[4], JM_REAL, c)
               && jm_real(q, s->array[2])[0] > 0;
    return s->number >= 0 && s->number % 256 < JM_FUNCTIONS && (p == 0 || p == 1 || p == d + 1) && c >= p
           && jm_has(q, s->array[1], JM_REAL, (c - p) * d) && jm_has(q, s->array[2], JM_REAL, d + 2);
}

static int jm_is_step(const jm_plan *q, const jm_step *s, int is_last) {
    const int64_t d = q->d, flat = s->number & JM_FLAT ? d : 1;
    int64_t r, c;
    const int in_place = s->code == JM_SHIFT || s->code == JM_CHOLESKY || s->code == JM_LDL || (s->code >= JM_PLANE && s->code <= JM_FORWARD);
    if (s->out < 1 || s->out >= q->registers || (s->out == 1) != is_last) return 0;
    if (in_place ? s->in != -1 : s->in < 0 || s->in >= q->registers || s->in == 1 || s->in == s->out) return 0;
    r = q->rows[s->out];
    c = in_place ? 0 : q->rows[s->in];
    switch (s->code) {
    case JM_ADD: return r == c && (s->number == 1 || s->number == -1);
    case JM_SHIFT: return jm_has(q, s->array[0], JM_REAL, r * d);
    case JM_TAKE: return jm_ids(q, s->array[0], r, c, 0);
    case JM_PUT: return jm_ids(q, s->array[0], -1, r, 1) && jm_ids(q, s->array[1], jm_length(q, s->array[0]), c, 0);
    case JM_SPARSE: return jm_is_sparse(q, s, r, c);
    case JM_DENSE: return !is_last && s->number >= 0 && s->number < 8 && jm_is_matrix(q, s->array[0], r * flat, c * flat);
    case JM_CHOLESKY:
        return !is_last && jm_is_packed(q, s->array[0], r * flat) && jm_has(q, s->array[1], JM_REAL, r * flat);
    case JM_LDL:
        return !is_last && jm_is_packed(q, s->array[0], r) && jm_has(q, s->array[1], JM_REAL, r) && jm_has(q, s->array[2], JM_REAL, r)
               && jm_ids(q, s->array[3], r, r, 0);
    case JM_KERNEL: case JM_MEAN: return jm_is_field(q, s, r, c);
    case JM_PLANE: return jm_ids(q, s->array[0], -1, r, 1) && jm_has(q, s->array[1], JM_REAL, d);
    case JM_TURN: return jm_ids(q, s->array[0], -1, r, 1) && jm_has(q, s->array[1], JM_REAL, d * d);
    case JM_PAIR: case JM_COPY: return !is_last && jm_is_pair(q, s, r);
    case JM_FORWARD: return !is_last && jm_is_sparse(q, s, r, r) && jm_ids(q, s->array[3], r, r, 0);
    default: return 0;
    }
}

/* Whether tables, registers and steps fit each other and the size of the file. */
static const char *jm_check(jm_plan *q, int64_t size) {
    static const char *damaged = "the plan is damaged: its tables do not fit each other.";
    const int64_t data = (int64_t)sizeof(int64_t) * (JM_HEAD + 3 * q->arrays + q->registers + JM_WORDS * q->steps);
    int64_t total = 0;
    for (int64_t a = 0; a < q->arrays; a++) {
        const jm_table *t = q->table + a;
        const int64_t width = t->kind == JM_INT ? 4 : 8;
        if (t->kind < JM_REAL || t->kind > JM_INT || t->offset < data || t->offset > size || t->offset % 8) return damaged;
        if (t->count < 0 || t->count > (size - t->offset) / width) return damaged;
    }
    for (int64_t k = 0; k < q->registers; k++) {
        if (q->rows[k] < 0 || q->rows[k] > size / 8) return damaged;
        q->place[k] = total;
        total += k == 1 ? 0 : q->rows[k] * q->d;
    }
    q->place[q->registers] = total;
    if (total > size || q->rows[0] != q->m || q->rows[1] != q->n) return damaged;
    if (!jm_has(q, q->rest, JM_REAL, q->n * q->d) || !jm_has(q, q->nodes, JM_LONG, q->m)) return damaged;
    for (int64_t k = 0; k < q->m; k++) if (jm_long(q, q->nodes)[k] < -1 || jm_long(q, q->nodes)[k] >= q->n) return damaged;
    if (q->layer != -1 && (q->d != 2 || !jm_ids(q, q->layer, -1, q->n, 0))) return damaged;
    for (int k = 0; k < 2; k++) if (q->axes[k] < 0 || q->axes[k] > 2) return damaged;
    for (int64_t k = 0; k < q->steps; k++) if (!jm_is_step(q, q->step + k, k >= q->first)) return damaged;
    return NULL;
}

/* Sums of 64-bit words, and of words times their positions. */
static void jm_sums(const int64_t *words, int64_t count, uint64_t sums[2]) {
    sums[0] = sums[1] = 0;
    for (int64_t i = 0; i < count; i++) { sums[0] += (uint64_t)words[i]; sums[1] += (uint64_t)words[i] * (uint64_t)(i + 1); }
}

static jm_plan *jm_read(jm_plan *q, FILE *file) {
    int64_t head[JM_HEAD], size;
    uint64_t sums[2];
    const char *wrong;
    const int32_t one = 1;
    if (*(const char *)&one != 1) return jm_fail(q, "this machine is big-endian; plans are little-endian.");
    if (fread(head, sizeof head, 1, file) != 1 || memcmp(head, "JMPLAN\r\n", 8)) return jm_fail(q, "this file is no plan of jaxmorph.");
    if (head[1] != 1) return jm_fail(q, "this plan is of another version; export it anew, or take the header of its jaxmorph.");
    size = head[2];
    if (fseek(file, 0, SEEK_END) || ftell(file) != size || size % 8) return jm_fail(q, "the plan is cut: its size is not that of its header.");
    q->d = head[5]; q->n = head[6]; q->m = head[7]; q->arrays = head[8]; q->registers = head[9]; q->steps = head[10];
    q->first = head[11]; q->rest = head[12]; q->nodes = head[13]; q->layer = head[14]; q->axes[0] = head[15]; q->axes[1] = head[16];
    for (int k = 6; k < 12; k++) if (head[k] < 0 || head[k] > size / 8) return jm_fail(q, "the plan is damaged: a count of its header exceeds its size.");
    if ((q->d != 2 && q->d != 3) || q->registers < 2 || q->first > q->steps || (int64_t)sizeof(int64_t) * (JM_HEAD + 3 * q->arrays + q->registers + JM_WORDS * q->steps) > size)
        return jm_fail(q, "the plan is damaged: a count of its header exceeds its size.");
    q->memory = (char *)malloc((size_t)size);
    q->place = (int64_t *)malloc((size_t)(q->registers + 1) * sizeof(int64_t));
    if (!q->memory || !q->place) return jm_fail(q, "memory is short for this plan.");
    if (fseek(file, 0, SEEK_SET) || fread(q->memory, (size_t)size, 1, file) != 1) return jm_fail(q, "the plan cannot be read.");
    jm_sums((const int64_t *)(const void *)q->memory + 5, size / 8 - 5, sums);
    if (sums[0] != (uint64_t)head[3] || sums[1] != (uint64_t)head[4]) return jm_fail(q, "the plan was changed: its check sum differs. Export it anew.");
    q->table = (const jm_table *)(const void *)(q->memory + JM_HEAD * sizeof(int64_t));
    q->rows = (const int64_t *)(const void *)(q->table + q->arrays);
    q->step = (const jm_step *)(const void *)(q->rows + q->registers);
    wrong = jm_check(q, size);
    return wrong ? jm_fail(q, wrong) : q;
}

jm_plan *jm_open(const char *path) {
    jm_plan *q = (jm_plan *)calloc(1, sizeof *q);
    FILE *file = q ? fopen(path, "rb") : NULL;
    if (!file) return q ? jm_fail(q, "the plan cannot be opened.") : NULL;
    q = jm_read(q, file);
    fclose(file);
    return q;
}

const char *jm_error(const jm_plan *q) { return !q ? "memory is short for this plan." : q->message[0] ? q->message : NULL; }

void jm_close(jm_plan *q) {
    if (!q) return;
    free(q->memory);
    free(q->place);
    free(q);
}

int64_t jm_dimension(const jm_plan *q) { return q->d; }
int64_t jm_count(const jm_plan *q) { return q->n; }
int64_t jm_moving(const jm_plan *q) { return q->m; }
const double *jm_rest(const jm_plan *q) { return jm_real(q, q->rest); }
const int64_t *jm_nodes(const jm_plan *q) { return jm_long(q, q->nodes); }

int64_t jm_layer(const jm_plan *q, const int32_t **points, int axes[2]) {
    if (q->layer < 0) return 0;
    *points = jm_int(q, q->layer);
    axes[0] = (int)q->axes[0];
    axes[1] = (int)q->axes[1];
    return jm_length(q, q->layer);
}

/* ---------------------------------------------------------------- motion */

static double *jm_register(const jm_plan *q, double *registers, int64_t k) { return k < 0 ? NULL : registers + q->place[k]; }

/* Doubles of the coefficients of a step as columns. */
static int64_t jm_room(const jm_plan *q, const jm_step *s) {
    return s->code == JM_KERNEL ? q->rows[s->in] * q->d : 0;
}

/* The registers, then for each step on the points its coefficients as columns. */
static int64_t jm_fit_size(const jm_plan *q) {
    int64_t size = q->place[q->registers] + 1;
    for (int64_t k = q->first; k < q->steps; k++) size += jm_room(q, q->step + k);
    return size;
}

/* One step for all rows of its register. */
static int jm_whole(const jm_plan *q, const jm_step *s, double *registers, int turned) {
    double *other = jm_register(q, registers, s->in), *columns = NULL, *in;
    int failed;
    if (s->code == JM_KERNEL && !(columns = (double *)calloc((size_t)(jm_room(q, s) + 1), sizeof(double)))) return 1;
    if (columns && !turned) jm_columns(other, q->rows[s->in], q->d, columns);
    in = columns ? columns : other;
    failed = jm_apply(q, s, 0, q->rows[s->out], in, jm_register(q, registers, s->out), turned ? in : NULL, turned);
    if (columns && turned) jm_add_columns(1, columns, q->rows[s->in], q->d, other);
    free(columns);
    return failed;
}

double *jm_fit(const jm_plan *q, const double *u) {
    double *fit = (double *)calloc((size_t)jm_fit_size(q), sizeof(double)), *more;
    if (!fit) return NULL;
    memcpy(fit, u, (size_t)(q->m * q->d) * sizeof(double));
    for (int64_t k = 0; k < q->first; k++) if (jm_whole(q, q->step + k, fit, 0)) { free(fit); return NULL; }
    more = fit + q->place[q->registers];
    for (int64_t k = q->first; k < q->steps; k++) {
        const jm_step *s = q->step + k;
        if (s->code == JM_KERNEL) jm_columns(fit + q->place[s->in], q->rows[s->in], q->d, more);
        more += jm_room(q, s);
    }
    return fit;
}

static void jm_move_rows(const jm_plan *q, const double *fit, int64_t first, int64_t last, double *points) {
    const double *more = fit + q->place[q->registers];
    memset(points, 0, (size_t)((last - first) * q->d) * sizeof(double));
    for (int64_t k = q->first; k < q->steps; k++) {
        const jm_step *s = q->step + k;
        jm_apply(q, s, first, last, s->code == JM_KERNEL ? more : s->in < 0 ? NULL : fit + q->place[s->in], points, NULL, 0);
        more += jm_room(q, s);
    }
}

/* Blocks begin at multiples of JM_ROWS: a point has the same bits in any range. */
void jm_move(const jm_plan *q, const double *fit, int64_t first, int64_t count, double *points) {
    for (int64_t at = first; at < first + count;) {
        int64_t end = (at / JM_ROWS + 1) * JM_ROWS;
        if (end > first + count) end = first + count;
        jm_move_rows(q, fit, at, end, points + (at - first) * q->d);
        at = end;
    }
}

int jm_deform(const jm_plan *q, const double *u, double *points) {
    double *fit = jm_fit(q, u);
    const int64_t blocks = (q->n + JM_ROWS - 1) / JM_ROWS;
    if (!fit) return 1;
#ifdef _OPENMP
#pragma omp parallel for schedule(static)
#endif
    for (int64_t k = 0; k < blocks; k++) {
        const int64_t first = k * JM_ROWS, count = q->n - first < JM_ROWS ? q->n - first : JM_ROWS;
        jm_move(q, fit, first, count, points + first * q->d);
    }
    free(fit);
    return 0;
}

/* Cotangents of the registers from a range of points: `out` is changed. Coefficients of fields stay columns. */
static void jm_pull_rows(const jm_plan *q, int64_t first, int64_t last, double *out, double *registers, double *more) {
    more += jm_fit_size(q) - q->place[q->registers] - 1;
    for (int64_t k = q->steps - 1; k >= q->first; k--) {
        const jm_step *s = q->step + k;
        more -= jm_room(q, s);
        jm_apply(q, s, first, last, NULL, out, s->code == JM_KERNEL ? more : jm_register(q, registers, s->in), 1);
    }
}

static void jm_pull_part(const jm_plan *q, const double *points_bar, int64_t first, int64_t last, double *registers) {
    double out[JM_ROWS * 3];
    for (int64_t at = first; at < last; at += JM_ROWS) {
        const int64_t end = last - at < JM_ROWS ? last : at + JM_ROWS;
        memcpy(out, points_bar + at * q->d, (size_t)((end - at) * q->d) * sizeof(double));
        jm_pull_rows(q, at, end, out, registers, registers + q->place[q->registers]);
    }
}

/* Parts of the points, as many for any number of threads, have sums of their own: equal bits. */
int jm_pullback(const jm_plan *q, const double *points_bar, double *u_bar) {
    const int64_t size = jm_fit_size(q), parts = q->n < 8 * JM_ROWS * JM_PARTS ? 1 : JM_PARTS;
    const int64_t length = ((q->n + parts - 1) / parts + JM_ROWS - 1) / JM_ROWS * JM_ROWS;
    double *registers = (double *)calloc((size_t)(size * parts), sizeof(double)), *more;
    int failed = 0;
    if (!registers) return 1;
#ifdef _OPENMP
#pragma omp parallel for schedule(static)
#endif
    for (int64_t k = 0; k < parts; k++) {
        const int64_t first = k * length, last = q->n < first + length ? q->n : first + length;
        if (first < last) jm_pull_part(q, points_bar, first, last, registers + k * size);
    }
    for (int64_t k = 1; k < parts; k++) jm_axpy(1, registers + k * size, registers, size);
    more = registers + q->place[q->registers];
    for (int64_t k = q->first; k < q->steps; k++) {
        const jm_step *s = q->step + k;
        if (s->code == JM_KERNEL) jm_add_columns(1, more, q->rows[s->in], q->d, registers + q->place[s->in]);
        more += jm_room(q, s);
    }
    for (int64_t k = q->first - 1; k >= 0 && !failed; k--) failed = jm_whole(q, q->step + k, registers, 1);
    if (!failed) memcpy(u_bar, registers, (size_t)(q->m * q->d) * sizeof(double));
    free(registers);
    return failed;
}

#endif /* JMPLAN_IMPLEMENTATION */
