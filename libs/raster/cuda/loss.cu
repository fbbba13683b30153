#include "raster/cuda/kernels.h"
#include "raster/cuda/srgb.cuh"

namespace splatbus::raster::cuda {
namespace {

constexpr int kTileX = 32, kTileY = 32, kRadius = 5, kTaps = 2 * kRadius + 1;
constexpr int kHaloX = kTileX + 2 * kRadius, kHaloY = kTileY + 2 * kRadius;
constexpr int kRowRun = 8, kColumnRun = 4;  // neighbours that a thread blurs at once, to read each value once for all
constexpr int kLossThreads = kTileX * kTileY / kColumnRun;
constexpr int kHaloPitch = kHaloX + 1, kRowPitch = kTileX + 1;  // free of bank conflicts for those runs
constexpr float kC1 = 0.01F * 0.01F, kC2 = 0.03F * 0.03F;

// Gaussian window of 11 taps, sigma 1.5, normalised.
__constant__ float kWindow[kTaps] = {0.00102838F, 0.00759876F, 0.03600077F, 0.10936069F, 0.21300554F, 0.26601172F,
                                     0.21300554F, 0.10936069F, 0.03600077F, 0.00759876F, 0.00102838F};

__device__ inline float srgb_slope(float v) {
  v = fminf(fmaxf(v, 0.0F), 1.0F);
  return v <= 0.0031308F ? 12.92F : (1.055F / 2.4F) * __powf(v, 1.0F / 2.4F - 1.0F);
}

struct LossPicture {
  const float* rendered;
  const std::uint8_t* const* targets;
  float* gradient;
  LossKernelOptions options;
};

struct Place {
  int view, channel, x0, y0;
  std::size_t plane;  // first element of this view's channel
};

/// Of a view; null: it has none.
__device__ inline const std::uint8_t* mask_of(const LossPicture& picture, const WorkspaceView& w, int view) {
  return picture.options.masks.of(view, static_cast<std::size_t>(w.width) * w.height);
}

__device__ inline Place place(const WorkspaceView& w) {
  Place p;
  p.view = blockIdx.z / 3;
  p.channel = blockIdx.z % 3;
  p.x0 = blockIdx.x * kTileX;
  p.y0 = blockIdx.y * kTileY;
  p.plane = static_cast<std::size_t>(blockIdx.z) * w.width * w.height;
  return p;
}

template <int kMaps>
using Rows = float[kMaps][kHaloY][kRowPitch];

/// Blurs along rows; `values(y, x, out)` gives the maps at a place of the halo.
template <int kMaps, class Values>
__device__ void blur_rows(Rows<kMaps>& rows, Values values) {
  constexpr int kRuns = kTileX / kRowRun;
  for (int item = threadIdx.x; item < kHaloY * kRuns; item += kLossThreads) {
    const int ly = item / kRuns, lx = item % kRuns * kRowRun;
    float sums[kMaps][kRowRun] = {};
#pragma unroll
    for (int k = 0; k < kRowRun + kTaps - 1; ++k) {
      float v[kMaps];
      values(ly, lx + k, v);
#pragma unroll
      for (int r = 0; r < kRowRun; ++r) {
        if (k < r || k - r >= kTaps) continue;
#pragma unroll
        for (int s = 0; s < kMaps; ++s) sums[s][r] += kWindow[k - r] * v[s];
      }
    }
#pragma unroll
    for (int s = 0; s < kMaps; ++s) {
#pragma unroll
      for (int r = 0; r < kRowRun; ++r) rows[s][ly][lx + r] = sums[s][r];
    }
  }
}

/// Blurs along columns the kColumnRun outputs that begin at (lx, ly).
template <int kMaps>
__device__ void blur_columns(const Rows<kMaps>& rows, int lx, int ly, float (&sums)[kColumnRun][kMaps]) {
#pragma unroll
  for (int k = 0; k < kColumnRun + kTaps - 1; ++k) {
#pragma unroll
    for (int s = 0; s < kMaps; ++s) {
      const float v = rows[s][ly + k][lx];
#pragma unroll
      for (int r = 0; r < kColumnRun; ++r) {
        if (k >= r && k - r < kTaps) sums[r][s] += kWindow[k - r] * v;
      }
    }
  }
}

/// SSIM's derivatives with respect to the window's mean, variance and covariance (zero padding outside the picture).
__global__ void __launch_bounds__(kLossThreads, 4) ssim_kernel(WorkspaceView w, LossPicture picture) {
  __shared__ float x[kHaloY][kHaloPitch], y[kHaloY][kHaloPitch];
  __shared__ Rows<5> rows;
  __shared__ float block_loss;
  const Place p = place(w);
  const int t = threadIdx.x;
  const std::uint8_t* target = picture.targets[p.view];
  if (target == nullptr) return;
  const std::uint8_t* const mask = mask_of(picture, w, p.view);
  if (t == 0) block_loss = 0.0F;
  for (int k = t; k < kHaloX * kHaloY; k += kLossThreads) {
    const int ly = k / kHaloX, lx = k - ly * kHaloX;
    const int gx = p.x0 + lx - kRadius, gy = p.y0 + ly - kRadius;
    const bool inside = gx >= 0 && gy >= 0 && gx < w.width && gy < w.height;
    const std::size_t at = static_cast<std::size_t>(gy) * w.width + gx;
    x[ly][lx] = inside ? display(picture.rendered[p.plane + at], picture.options.encode_srgb) : 0.0F;
    y[ly][lx] = inside ? target[4 * at + p.channel] * (1.0F / 255.0F) : 0.0F;
    if (mask != nullptr && inside && mask[at] != 0) y[ly][lx] = x[ly][lx];
  }
  __syncthreads();
  blur_rows<5>(rows, [&](int ly, int lx, float(&v)[5]) {
    const float a = x[ly][lx], b = y[ly][lx];
    v[0] = a;
    v[1] = b;
    v[2] = a * a;
    v[3] = b * b;
    v[4] = a * b;
  });
  __syncthreads();
  const int lx = t % kTileX, ly = t / kTileX * kColumnRun;
  float moments[kColumnRun][5] = {};
  blur_columns<5>(rows, lx, ly, moments);
  float loss = 0.0F;
#pragma unroll
  for (int r = 0; r < kColumnRun; ++r) {
    const int gx = p.x0 + lx, gy = p.y0 + ly + r;
    if (gx >= w.width || gy >= w.height) continue;
    const float(&m)[5] = moments[r];
    const float variance_x = m[2] - m[0] * m[0], variance_y = m[3] - m[1] * m[1], covariance = m[4] - m[0] * m[1];
    const float a1 = 2.0F * m[0] * m[1] + kC1, a2 = 2.0F * covariance + kC2;
    const float inv_b1 = 1.0F / (m[0] * m[0] + m[1] * m[1] + kC1), inv_b2 = 1.0F / (variance_x + variance_y + kC2);
    const float inv = inv_b1 * inv_b2, ssim = a1 * a2 * inv;
    // By chain rule through E[x^2] and E[xy]: see the second kernel.
    const float d_variance = -ssim * inv_b2, d_covariance = 2.0F * a1 * inv;
    const float d_mean =
        2.0F * m[1] * a2 * inv - 2.0F * m[0] * ssim * inv_b1 - 2.0F * m[0] * d_variance - m[1] * d_covariance;
    const std::size_t at = p.plane + static_cast<std::size_t>(gy) * w.width + gx;
    const std::size_t planes = static_cast<std::size_t>(3) * w.batch * w.width * w.height;
    w.ssim_partials[at] = d_mean;
    w.ssim_partials[planes + at] = d_variance;
    w.ssim_partials[2 * planes + at] = d_covariance;
    const float difference = x[ly + r + kRadius][lx + kRadius] - y[ly + r + kRadius][lx + kRadius];
    loss += picture.options.ssim_weight * (1.0F - ssim) + (1.0F - picture.options.ssim_weight) * fabsf(difference);
  }
  for (int mask = 16; mask >= 1; mask /= 2) loss += __shfl_xor_sync(0xFFFFFFFFU, loss, mask);
  if ((t & 31) == 0) atomicAdd(&block_loss, loss);
  __syncthreads();
  if (t == 0) {
    atomicAdd(w.loss + p.view, block_loss * picture.options.weight / (3.0F * w.width * w.height));
  }
}

/// Of a picture without a target.
__device__ void clear_gradient(const WorkspaceView& w, const LossPicture& picture, const Place& p) {
  for (int k = threadIdx.x; k < kTileX * kTileY; k += kLossThreads) {
    const int gx = p.x0 + k % kTileX, gy = p.y0 + k / kTileX;
    if (gx >= w.width || gy >= w.height) continue;
    picture.gradient[p.plane + static_cast<std::size_t>(gy) * w.width + gx] = 0.0F;
  }
}

__global__ void __launch_bounds__(kLossThreads, 4) loss_gradient_kernel(WorkspaceView w, LossPicture picture) {
  __shared__ float maps[3][kHaloY][kHaloPitch];
  __shared__ Rows<3> rows;
  const Place p = place(w);
  const int t = threadIdx.x;
  const std::uint8_t* target = picture.targets[p.view];
  if (target == nullptr) return clear_gradient(w, picture, p);
  const std::uint8_t* const mask = mask_of(picture, w, p.view);
  const std::size_t planes = static_cast<std::size_t>(3) * w.batch * w.width * w.height;
  for (int k = t; k < kHaloX * kHaloY; k += kLossThreads) {
    const int ly = k / kHaloX, lx = k - ly * kHaloX;
    const int gx = p.x0 + lx - kRadius, gy = p.y0 + ly - kRadius;
    const bool inside = gx >= 0 && gy >= 0 && gx < w.width && gy < w.height;
    const std::size_t at = p.plane + static_cast<std::size_t>(gy) * w.width + gx;
    for (int s = 0; s < 3; ++s) maps[s][ly][lx] = inside ? w.ssim_partials[s * planes + at] : 0.0F;
  }
  __syncthreads();
  blur_rows<3>(rows, [&](int ly, int lx, float(&v)[3]) {
    for (int s = 0; s < 3; ++s) v[s] = maps[s][ly][lx];
  });
  __syncthreads();
  const int lx = t % kTileX, ly = t / kTileX * kColumnRun;
  float sums[kColumnRun][3] = {};
  blur_columns<3>(rows, lx, ly, sums);
#pragma unroll
  for (int r = 0; r < kColumnRun; ++r) {
    const int gx = p.x0 + lx, gy = p.y0 + ly + r;
    if (gx >= w.width || gy >= w.height) continue;
    const std::size_t at = static_cast<std::size_t>(gy) * w.width + gx;
    const float raw = picture.rendered[p.plane + at];
    const float a = display(raw, picture.options.encode_srgb);
    const float b = target[4 * at + p.channel] * (1.0F / 255.0F);
    const float d_ssim = sums[r][0] + 2.0F * a * sums[r][1] + b * sums[r][2];
    const float sign = a > b ? 1.0F : (a < b ? -1.0F : 0.0F);
    float d = ((1.0F - picture.options.ssim_weight) * sign - picture.options.ssim_weight * d_ssim) *
              picture.options.weight / (3.0F * w.width * w.height);
    if (picture.options.encode_srgb) {
      // Outside [0, 1] only a gradient that points back inside passes: descent moves against d.
      if ((raw < 0.0F && d > 0.0F) || (raw > 1.0F && d < 0.0F)) d = 0.0F;
      d *= srgb_slope(raw);
    }
    if (mask != nullptr && mask[at] != 0) d = 0.0F;
    picture.gradient[p.plane + at] = d;
  }
}

}  // namespace

void launch_loss(const float* rendered, const std::uint8_t* const* targets, float* gradient,
                 const WorkspaceView& workspace, const LossKernelOptions& options, cudaStream_t stream) {
  const LossPicture picture{rendered, targets, gradient, options};
  const dim3 blocks((workspace.width + kTileX - 1) / kTileX, (workspace.height + kTileY - 1) / kTileY,
                    3 * workspace.batch);
  ssim_kernel<<<blocks, kLossThreads, 0, stream>>>(workspace, picture);
  loss_gradient_kernel<<<blocks, kLossThreads, 0, stream>>>(workspace, picture);
  check(cudaGetLastError(), "loss");
}

}  // namespace splatbus::raster::cuda
