// The shadow march by hand, to measure ours against: one point light, Lambert and Phong, every pixel's ray looked up in the depth at
// so many steps.  gcc -O3 -march=native -ffast-math -fopenmp -shared -fPIC; strips of separate arrays, so that the inner loops become
// vector code; a strip ends where no ray of it is left.
#include <math.h>
#include <stddef.h>
#define STRIP 64

// Camera frame: x right, y down, z forward; N in it too.  O = A * diffuse + specular of a light at (lx, ly, lz).
void march(const float *restrict Z, const float *restrict N, const float *restrict A, float *restrict O, float *restrict S, int H, int W, float lx, float ly,
           float lz, float fx, float fy, float cx, float cy, float ks, int steps, float farthest, float near, float bias, float thick) {
  const float per_fx = 1.f / fx, per_fy = 1.f / fy;
#pragma omp parallel for schedule(dynamic, 8)
  for (int y = 0; y < H; y++) {
    const float *z_ = Z + (size_t)y * W, *n_ = N + (size_t)3 * y * W, *a_ = A + (size_t)3 * y * W;
    float *o = O + (size_t)3 * y * W, *s_ = S + (size_t)y * W, slope = (y - cy) * per_fy;
    for (int first = 0; first < W; first += STRIP) {
      int m = W - first < STRIP ? W - first : STRIP;
      float px[STRIP], py[STRIP], pz[STRIP], nx[STRIP], ny[STRIP], nz[STRIP], ax[STRIP], ay[STRIP], az[STRIP], far_[STRIP];
      float u[STRIP], v[STRIP], k[STRIP], du[STRIP], dv[STRIP], dk[STRIP], lit[STRIP];
#pragma GCC ivdep
      for (int i = 0; i < m; i++) {
        int x = first + i;
        float d = z_[x];
        px[i] = (x - cx) * per_fx * d; py[i] = slope * d; pz[i] = d;
        nx[i] = n_[3 * x]; ny[i] = n_[3 * x + 1]; nz[i] = n_[3 * x + 2];
        float a = lx - px[i], b = ly - py[i], c = lz - pz[i], l = sqrtf(a * a + b * b + c * c), r = 1.f / l;
        ax[i] = a * r; ay[i] = b * r; az[i] = c * r; far_[i] = l;
        float t = l < farthest ? l : farthest, x0 = px[i] + bias * nx[i], y0 = py[i] + bias * ny[i], z0 = d + bias * nz[i];
        float most = (z0 - near) / (-az[i] > 1e-9f ? -az[i] : 1e-9f);
        most = az[i] < 0 ? most : 1e30f;
        t = most < t ? most : t;
        float q0 = 1.f / z0, q1 = 1.f / (z0 + az[i] * t), step = 1.f / steps;
        u[i] = x0 * q0 * fx + cx + .5f; v[i] = y0 * q0 * fy + cy + .5f; k[i] = q0;
        du[i] = ((x0 + ax[i] * t) * q1 * fx + cx + .5f - u[i]) * step;
        dv[i] = ((y0 + ay[i] * t) * q1 * fy + cy + .5f - v[i]) * step;
        dk[i] = (q1 - q0) * step;
        lit[i] = 1.f;
      }
      const float wide = W, high = H;
      for (int s = 1; s <= steps; s++) {
        float at = s, left = 0;
#pragma GCC ivdep
        for (int i = 0; i < m; i++) {
          float uu = u[i] + du[i] * at, vv = v[i] + dv[i] * at;
          int inside = (uu >= 0) & (vv >= 0) & (uu < wide) & (vv < high);
          int at_ = inside ? (int)vv * W + (int)uu : 0;
          float behind = 1.f / (k[i] + dk[i] * at) - Z[at_];
          int hit = inside & (behind > bias) & (behind < thick);
          float l = hit ? 0.f : lit[i];
          lit[i] = l;
          left += inside ? l : 0.f;
        }
        if (left == 0.f) break;
      }
#pragma GCC ivdep
      for (int i = 0; i < m; i++) {
        int x = first + i;
        float r = 1.f / far_[i], strength = r * r * lit[i], nl = nx[i] * ax[i] + ny[i] * ay[i] + nz[i] * az[i], front = nl > 0 ? nl : 0.f;
        float back = -1.f / sqrtf(px[i] * px[i] + py[i] * py[i] + pz[i] * pz[i]), vx = px[i] * back, vy = py[i] * back, vz = pz[i] * back;
        float rv = 2.f * front * (nx[i] * vx + ny[i] * vy + nz[i] * vz) - (ax[i] * vx + ay[i] * vy + az[i] * vz);
        rv = rv > 0 ? rv : 0.f;
        rv *= rv; rv *= rv; rv *= rv; rv *= rv; rv *= rv;
        float e = front * strength, g = nl > 0 ? rv * strength * ks : 0.f;
        o[3 * x] = a_[3 * x] + a_[3 * x] * e + g; o[3 * x + 1] = a_[3 * x + 1] + a_[3 * x + 1] * e + g; o[3 * x + 2] = a_[3 * x + 2] + a_[3 * x + 2] * e + g;
        s_[x] = lit[i];
      }
    }
  }
}
