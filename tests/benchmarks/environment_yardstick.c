/* The yardstick of bench_environment.py: the same layers in plain C, rows in blocks of 64 so that the compiler vectorises them.
   gcc -O3 -march=native -ffast-math -fopenmp -shared -fPIC */
#include <math.h>
#include <stddef.h>

#define BLOCK 64

static inline float angle(float y, float x) {
  float ax = fabsf(x), ay = fabsf(y), mx = ax > ay ? ax : ay, mn = ax > ay ? ay : ax, a = mn / (mx + 1e-30f), s = a * a;
  float r = a * (0.99997726f + s * (-0.33262347f + s * (0.19354346f + s * (-0.11643287f + s * (0.05265332f + s * -0.01172120f)))));
  r = ay > ax ? 1.57079637f - r : r;
  r = x < 0 ? 3.14159274f - r : r;
  return y < 0 ? -r : r;
}

static inline void index_of(float dx, float dy, float dz, int w, int h, int *i00, int *i01, int *i10, int *i11, float *pu, float *pv) {
  float u = (angle(dx, -dz) * 0.159154943f + .5f) * w - .5f;
  float v = angle(sqrtf(dx * dx + dz * dz), dy) * 0.318309886f * h - .5f;
  float u0 = __builtin_floorf(u), v0 = __builtin_floorf(v);
  *pu = u - u0;
  *pv = v - v0;
  int ui = (int)u0, vi = (int)v0;
  int ua = ui < 0 ? ui + w : ui;
  ua = ua >= w ? ua - w : ua;
  int ub = ua + 1;
  ub = ub >= w ? 0 : ub;
  int va = vi < 0 ? 0 : vi;
  va = va > h - 1 ? h - 1 : va;
  int vb = vi + 1;
  vb = vb < 0 ? 0 : vb;
  vb = vb > h - 1 ? h - 1 : vb;
  *i00 = 3 * (va * w + ua);
  *i01 = 3 * (va * w + ub);
  *i10 = 3 * (vb * w + ua);
  *i11 = 3 * (vb * w + ub);
}

/* r, g, b += k * map(direction) */
static inline void add_map(const float *restrict E, int w, int h, int m, float k, const float *restrict X, const float *restrict Y,
                           const float *restrict Z, float *restrict r, float *restrict g, float *restrict b) {
  int a0[BLOCK], a1[BLOCK], a2[BLOCK], a3[BLOCK];
  float fu[BLOCK], fv[BLOCK];
#pragma GCC ivdep
  for (int i = 0; i < m; i++) index_of(X[i], Y[i], Z[i], w, h, a0 + i, a1 + i, a2 + i, a3 + i, fu + i, fv + i);
#pragma GCC ivdep
  for (int i = 0; i < m; i++) {
    float p = fu[i], q = fv[i], w00 = (1 - p) * (1 - q) * k, w01 = p * (1 - q) * k, w10 = (1 - p) * q * k, w11 = p * q * k;
    r[i] += E[a0[i]] * w00 + E[a1[i]] * w01 + E[a2[i]] * w10 + E[a3[i]] * w11;
    g[i] += E[a0[i] + 1] * w00 + E[a1[i] + 1] * w01 + E[a2[i] + 1] * w10 + E[a3[i] + 1] * w11;
    b[i] += E[a0[i] + 2] * w00 + E[a1[i] + 2] * w01 + E[a2[i] + 2] * w10 + E[a3[i] + 2] * w11;
  }
}

/* Layers that are NULL are left out.  D: irradiance; A, B: two levels of the map, B's share t. */
void environment(const float *P, const float *N, const float *albedo, int H, int W, float ior, float t, const float *D, int dw, int dh,
                 const float *A, int aw, int ah, const float *B, int bw, int bh, float *diffuse, float *reflection, float *refraction) {
#pragma omp parallel for schedule(dynamic, 8)
  for (int y = 0; y < H; y++) {
    for (int x = 0; x < W; x += BLOCK) {
      int m = W - x < BLOCK ? W - x : BLOCK;
      size_t o = 3 * ((size_t)y * W + x);
      const float *restrict p = P + o, *restrict n = N + o, *restrict al = albedo + o;
      float nx[BLOCK], ny[BLOCK], nz[BLOCK], vx[BLOCK], vy[BLOCK], vz[BLOCK], nv[BLOCK], F[BLOCK], G[BLOCK];
      float dx[BLOCK], dy[BLOCK], dz[BLOCK], r[BLOCK], g[BLOCK], b[BLOCK];
#pragma GCC ivdep
      for (int i = 0; i < m; i++) {
        float a = n[3 * i], bb = n[3 * i + 1], c = n[3 * i + 2], s = 1.f / sqrtf(a * a + bb * bb + c * c);
        float px = p[3 * i], py = p[3 * i + 1], pz = p[3 * i + 2], q = -1.f / sqrtf(px * px + py * py + pz * pz);
        nx[i] = a * s; ny[i] = bb * s; nz[i] = c * s; vx[i] = px * q; vy[i] = py * q; vz[i] = pz * q;
        nv[i] = nx[i] * vx[i] + ny[i] * vy[i] + nz[i] * vz[i];
      }
      if (diffuse) {
        for (int i = 0; i < m; i++) r[i] = g[i] = b[i] = 0;
        add_map(D, dw, dh, m, 1.f, nx, ny, nz, r, g, b);
        float *restrict out = diffuse + o;
#pragma GCC ivdep
        for (int i = 0; i < m; i++) { out[3 * i] = al[3 * i] * r[i]; out[3 * i + 1] = al[3 * i + 1] * g[i]; out[3 * i + 2] = al[3 * i + 2] * b[i]; }
      }
      if (reflection || refraction) {
#pragma GCC ivdep
        for (int i = 0; i < m; i++) {
          float c = nv[i] > 0 ? nv[i] : 0, step = ior * ior - 1, w = sqrtf(step + c * c), a = step / ((w + c) * (w + c));
          float e = (c * (w + c) - 1) / (c * (w - c) + 1);
          F[i] = .5f * a * a * (1 + e * e);
          G[i] = c - w;
        }
      }
      for (int way = 0; way < 2; way++) {
        float *restrict out = way ? refraction : reflection;
        if (!out) continue;
        out += o;
        if (way == 0) {
#pragma GCC ivdep
          for (int i = 0; i < m; i++) { float k = 2 * nv[i]; dx[i] = k * nx[i] - vx[i]; dy[i] = k * ny[i] - vy[i]; dz[i] = k * nz[i] - vz[i]; }
        } else {
#pragma GCC ivdep
          for (int i = 0; i < m; i++) { float k = G[i], j = 1 / ior; dx[i] = (k * nx[i] - vx[i]) * j; dy[i] = (k * ny[i] - vy[i]) * j; dz[i] = (k * nz[i] - vz[i]) * j; }
        }
        for (int i = 0; i < m; i++) r[i] = g[i] = b[i] = 0;
        add_map(A, aw, ah, m, 1 - t, dx, dy, dz, r, g, b);
        if (t > 0) add_map(B, bw, bh, m, t, dx, dy, dz, r, g, b);
#pragma GCC ivdep
        for (int i = 0; i < m; i++) { float k = way ? 1 - F[i] : F[i]; out[3 * i] = r[i] * k; out[3 * i + 1] = g[i] * k; out[3 * i + 2] = b[i] * k; }
      }
    }
  }
}
