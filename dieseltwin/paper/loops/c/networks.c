/* Elementary functions and small networks at the points of a block, side by side: points are the vectors' dimension.

   Stands above: `real`; BLOCK, the points of a row, a multiple of STRIP vectors. Rows are aligned to 64 bytes. */

#include <stdint.h>
#define INLINE static inline __attribute__((always_inline))

/* exp and log of single precision, to 2e-7 relative (Cephes' polynomials, Moshier 1992). A call of the mathematics
   library empties all vector registers; written out, a point's forty of them take a third of the time. Arguments of
   exp are limited to -87 .. 88, those of log are normal numbers. */
INLINE float exp_single(float x) {
    union { int32_t bits; float value; } power;
    x = x < -87.0f ? -87.0f : x;
    x = x > 88.0f ? 88.0f : x;
    const float k = rintf(x * 1.44269504f);
    const float r = x - k * 0.693359375f + k * 2.12194440e-4f;
    float p = 1.9875691500e-4f;
    p = p * r + 1.3981999507e-3f;
    p = p * r + 8.3334519073e-3f;
    p = p * r + 4.1665795894e-2f;
    p = p * r + 1.6666665459e-1f;
    p = p * r + 5.0000001201e-1f;
    power.bits = ((int32_t)k + 127) << 23;
    return (p * r * r + r + 1.0f) * power.value;
}
INLINE float log_single(float x) {
    union { int32_t bits; float value; } part;
    part.value = x > 1.2e-38f ? x : 1.2e-38f;
    const int32_t k = (part.bits - 0x3f3504f3) >> 23;
    part.bits -= k << 23;
    const float f = part.value - 1.0f;
    float p = 7.0376836292e-2f;
    p = p * f - 1.1514610310e-1f;
    p = p * f + 1.1676998740e-1f;
    p = p * f - 1.2420140846e-1f;
    p = p * f + 1.4249322787e-1f;
    p = p * f - 1.6668057665e-1f;
    p = p * f + 2.0000714765e-1f;
    p = p * f - 2.4999993993e-1f;
    p = p * f + 3.3333331174e-1f;
    return f + (p * f * f * f + (float)k * -2.12194440e-4f - 0.5f * f * f) + (float)k * 0.693359375f;
}
#define exp_of(x) _Generic((x), float: exp_single, double: exp)(x)
#define log_of(x) _Generic((x), float: log_single, double: log)(x)

/* A tile of TILE x STRIP sums stays in 25 of the 32 registers of AVX-512: some 200 GFLOP/s of a Zen 5 core. */
enum { WIDTH = 64 / sizeof(real), STRIP = 5, TILE = 5 };
typedef real vec __attribute__((vector_size(64), may_alias));

/* `tile` rows of y[o] = offset[o] + sum over i of w[i * by_in + o * by_out] x[i], at STRIP vectors of points. */
INLINE void tile_of(const int tile, const int in, const real* w, const long by_in, const long by_out,
                    const real* offset, const real* x, real* y) {
    vec sum[TILE][STRIP];
#pragma GCC unroll 5
    for (int o = 0; o < tile; ++o)
#pragma GCC unroll 5
        for (int s = 0; s < STRIP; ++s) sum[o][s] = (vec){} + (offset ? offset[o] : (real)0);
#pragma GCC unroll 2
    for (int i = 0; i < in; ++i)
#pragma GCC unroll 5
        for (int o = 0; o < tile; ++o)
#pragma GCC unroll 5
            for (int s = 0; s < STRIP; ++s) sum[o][s] += w[i * by_in + o * by_out] * ((const vec*)(x + i * BLOCK))[s];
#pragma GCC unroll 5
    for (int o = 0; o < tile; ++o)
#pragma GCC unroll 5
        for (int s = 0; s < STRIP; ++s) ((vec*)(y + o * BLOCK))[s] = sum[o][s];
}

/* All `out` rows of y from `in` rows of x; `offset` 0 is none. */
INLINE void product(const int in, const int out, const real* w, const long by_in, const long by_out,
                    const real* offset, const real* x, real* y) {
    for (int p = 0; p < BLOCK; p += STRIP * WIDTH) {
        int o = 0;
        for (; o + TILE <= out; o += TILE)
            tile_of(TILE, in, w + o * by_out, by_in, by_out, offset ? offset + o : 0, x + p, y + o * BLOCK + p);
        for (; o < out; ++o)
            tile_of(1, in, w + o * by_out, by_in, by_out, offset ? offset + o : 0, x + p, y + o * BLOCK + p);
    }
}

/* Activations in place, and a gradient times their slope, which the activation's value tells. */
INLINE void tanh_rows(const int rows, real* h) {
    for (int k = 0; k < rows * BLOCK; ++k) h[k] = tanh(h[k]);
}
INLINE void tanh_slope(const int rows, const real* restrict h, real* restrict d) {
    for (int k = 0; k < rows * BLOCK; ++k) d[k] *= (real)1 - h[k] * h[k];
}
INLINE void algebraic_rows(const int rows, real* h) {
    for (int k = 0; k < rows * BLOCK; ++k) h[k] = h[k] / sqrt((real)1 + h[k] * h[k]);
}
INLINE void algebraic_slope(const int rows, const real* restrict h, real* restrict d) {
    for (int k = 0; k < rows * BLOCK; ++k) {
        const real s = (real)1 - h[k] * h[k];
        d[k] *= s * sqrt(s);
    }
}

/* Rates r of a layer of tanhs, from its values h and the rates q of their arguments. */
INLINE void tanh_rates(const int rows, const real* restrict h, const real* restrict q, real* restrict r) {
    for (int k = 0; k < rows * BLOCK; ++k) r[k] = ((real)1 - h[k] * h[k]) * q[k];
}

/* Gradients by values and rates of such a layer become those by its arguments and their rates. */
INLINE void rated_slope(const int rows, const real* restrict h, const real* restrict q, real* restrict d,
                        real* restrict d_rate) {
    for (int k = 0; k < rows * BLOCK; ++k) {
        const real s = (real)1 - h[k] * h[k];
        d[k] = s * (d[k] - (real)2 * h[k] * q[k] * d_rate[k]);
        d_rate[k] *= s;
    }
}

/* sums[o * in + i] += d[o] x[i] over the points, a vector of partial sums each. */
INLINE void outer_tile(const int out, const int in, const int by_out, const real* d, const real* x, vec* sums) {
    vec sum[TILE][TILE];
#pragma GCC unroll 5
    for (int o = 0; o < out; ++o)
#pragma GCC unroll 5
        for (int i = 0; i < in; ++i) sum[o][i] = sums[o * by_out + i];
    for (int k = 0; k < BLOCK / WIDTH; ++k)
#pragma GCC unroll 5
        for (int o = 0; o < out; ++o)
#pragma GCC unroll 5
            for (int i = 0; i < in; ++i) sum[o][i] += ((const vec*)(d + o * BLOCK))[k] * ((const vec*)(x + i * BLOCK))[k];
#pragma GCC unroll 5
    for (int o = 0; o < out; ++o)
#pragma GCC unroll 5
        for (int i = 0; i < in; ++i) sums[o * by_out + i] = sum[o][i];
}
INLINE void outer_rows(const int out, const int in, const int by_out, const real* d, const real* x, vec* sums) {
    int i = 0;
    for (; i + TILE <= in; i += TILE) outer_tile(out, TILE, by_out, d, x + i * BLOCK, sums + i);
    for (; i < in; ++i) outer_tile(out, 1, by_out, d, x + i * BLOCK, sums + i);
}
INLINE void outer(const int out, const int in, const real* d, const real* x, vec* sums) {
    int o = 0;
    for (; o + TILE <= out; o += TILE) outer_rows(TILE, in, in, d + o * BLOCK, x, sums + o * in);
    for (; o < out; ++o) outer_rows(1, in, in, d + o * BLOCK, x, sums + o * in);
}
INLINE void row_sums(const int rows, const real* d, vec* sums) {
    for (int o = 0; o < rows; ++o)
        for (int k = 0; k < BLOCK / WIDTH; ++k) sums[o] += ((const vec*)(d + o * BLOCK))[k];
}
