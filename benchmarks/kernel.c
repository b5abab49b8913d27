/* The pair kernel in C, as a reference for the one that Numba compiles: the likelihood of one detection under each particle
 * of a block, where the deviations follow the particle. float32, one row of BLOCK numbers per quantity, as in
 * phdtrack.kernels.box_blocks. Compiled twice: with a polynomial exp (POLYNOMIAL 1) or with the library's expf, which
 * vectorises through libmvec where glibc has it. */
#include <math.h>
#include <stdint.h>
#include <string.h>

#define BLOCK 256

static inline float exp_negative(float x) {
#if POLYNOMIAL
    x = x < -87.0f ? -87.0f : x;
    float whole = floorf(x * 1.44269504f + 0.5f);
    float r = x - whole * 0.693359375f + whole * 2.12194440e-4f;
    /* Taylor to the sixth power: 1e-7 on |r| <= log(2) / 2. */
    float p = 1.0f + r * (1.0f + r * (0.5f + r * (1.0f / 6 + r * (1.0f / 24 + r * (1.0f / 120 + r * (1.0f / 720))))));
    int32_t bits = ((int32_t)whole + 127) << 23;
    float power;
    memcpy(&power, &bits, sizeof power);
    return p * power;
#else
    return expf(x < -87.0f ? -87.0f : x);
#endif
}

/* rows: x, y, w, h, 1/sigma_w, 1/sigma_h, normaliser, alive; z: 4 numbers for each of `count` detections.
 * out: for each detection the sum of the likelihoods and the number of particles in the region; g: of the last one. */
void pair_sums(const float *restrict rows, int n, const float *restrict z, int count, float region, float *restrict g,
               float *restrict out) {
    const float *restrict x = rows, *restrict y = rows + BLOCK, *restrict w = rows + 2 * BLOCK, *restrict h = rows + 3 * BLOCK;
    const float *restrict iw = rows + 4 * BLOCK, *restrict ih = rows + 5 * BLOCK;
    const float *restrict scale = rows + 6 * BLOCK, *restrict alive = rows + 7 * BLOCK;
    for (int j = 0; j < count; j++) {
        float zx = z[4 * j], zy = z[4 * j + 1], zw = z[4 * j + 2], zh = z[4 * j + 3];
        float total = 0.0f, near = 0.0f;
        for (int i = 0; i < n; i++) {
            float dx = (zx - x[i]) * iw[i], dy = (zy - y[i]) * ih[i];
            float dw = (zw - w[i]) * iw[i], dh = (zh - h[i]) * ih[i];
            float distance2 = 4.0f * (dx * dx + dy * dy) + (dw * dw + dh * dh);
            float value = exp_negative(-0.5f * distance2) * scale[i] * alive[i];
            g[i] = value;
            total += value;
            near += distance2 <= region ? alive[i] : 0.0f;
        }
        out[2 * j] = total;
        out[2 * j + 1] = near;
    }
}
