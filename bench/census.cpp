#include "bench/census.h"

#include <tbb/blocked_range.h>
#include <tbb/combinable.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <glm/gtc/quaternion.hpp>
#include <numeric>
#include <optional>
#include <vector>

namespace splatbus::bench {
namespace {

constexpr float kAlphaMin = 1.0F / 255.0F, kAlphaMax = 0.999F, kTransmittanceMin = 1e-4F;
constexpr float kLog2AlphaMin = -7.994353436858858F;
constexpr float kWhiteScale = 0.8493218002880191F;  // sqrt(log2(e) / 2)

using Marks = std::vector<std::uint8_t>;

void mark(Marks& marks, std::uint32_t i) {
  std::atomic_ref(marks[i]).store(1, std::memory_order_relaxed);
}

/// A projected Gaussian: alpha = 2^(log2_alpha - u^2 - v^2), u = uxx dx + uxy dy, v = uyy dy.
struct Record {
  float depth, x, y, log2_alpha, uxx, uxy, uyy;
  std::uint32_t gaussian;
  std::int32_t first_row, last_row;

  [[nodiscard]] float level() const { return log2_alpha - kLog2AlphaMin; }
};

/// Pixels [first, last] of one row; empty when last < first.
struct Span {
  std::int32_t first = 0, last = -1;
};

/// Of pixel centres within the ellipse in which alpha reaches 1/255.
Span span_of(const Record& r, std::int32_t row, std::int32_t width) {
  const float dy = static_cast<float>(row) + 0.5F - r.y, v = r.uyy * dy;
  const float rest = r.level() - v * v;
  if (rest < 0) return {};
  const float centre = r.x - r.uxy * dy / r.uxx, half = std::sqrt(rest) / r.uxx;
  const float first = std::max(std::ceil(centre - half - 0.5F), 0.0F);
  const float last = std::min(std::floor(centre + half - 0.5F), static_cast<float>(width - 1));
  if (!(first <= last)) return {};
  return {static_cast<std::int32_t>(first), static_cast<std::int32_t>(last)};
}

/// Local affine approximation, as in the rasterisers; nothing when the Gaussian cannot be seen.
std::optional<Record> project_gaussian(const GaussiansView& gaussians, std::size_t i, const Camera& camera,
                                       const glm::mat3& rotation, const glm::vec3& translation,
                                       const raster::RenderOptions& options) {
  const auto at = [&](int channel) { return gaussians.plane(channel)[i]; };
  const glm::vec3 p = rotation * glm::vec3(at(0), at(1), at(2)) + translation;
  if (!(p.z > camera.near_m)) return {};
  const float half_x = 0.5F * static_cast<float>(camera.width) / camera.fx;
  const float half_y = 0.5F * static_cast<float>(camera.height) / camera.fy;
  const float tan_x = std::clamp(p.x / p.z, -camera.cx / camera.fx - 0.3F * half_x,
                                 (static_cast<float>(camera.width) - camera.cx) / camera.fx + 0.3F * half_x);
  const float tan_y = std::clamp(p.y / p.z, -camera.cy / camera.fy - 0.3F * half_y,
                                 (static_cast<float>(camera.height) - camera.cy) / camera.fy + 0.3F * half_y);
  const glm::mat3 rows = glm::transpose(rotation);
  const glm::vec3 t0 = camera.fx / p.z * (rows[0] - tan_x * rows[2]);
  const glm::vec3 t1 = camera.fy / p.z * (rows[1] - tan_y * rows[2]);
  const glm::mat3 r = glm::mat3_cast(glm::normalize(glm::quat(at(6), at(7), at(8), at(9))));
  const glm::vec3 scale(std::exp(at(3)), std::exp(at(4)), std::exp(at(5)));
  const glm::vec3 m0 = t0 * r * scale, m1 = t1 * r * scale;

  const glm::vec3 minor = glm::cross(m0, m1);
  const float c_sharp = glm::dot(m1, m1), b = glm::dot(m0, m1), c = c_sharp + options.blur_px2;
  const float det_sharp = glm::dot(minor, minor);
  const float det = det_sharp + options.blur_px2 * (glm::dot(m0, m0) + c);
  float alpha = 1 / (1 + std::exp(-at(ParameterLayout::kOpacityLogit)));
  if (options.antialias) alpha *= std::sqrt(det_sharp / det);
  if (!(alpha >= kAlphaMin && det > 0 && std::isfinite(det))) return {};

  Record out{};
  out.depth = p.z;
  out.x = camera.fx * p.x / p.z + camera.cx;
  out.y = camera.fy * p.y / p.z + camera.cy;
  out.log2_alpha = std::log2(alpha);
  out.uxx = kWhiteScale * std::sqrt(c / det);
  out.uxy = -kWhiteScale * b / std::sqrt(c * det);
  out.uyy = kWhiteScale / std::sqrt(c);
  out.gaussian = static_cast<std::uint32_t>(i);
  const float reach = std::sqrt(out.level()) / out.uyy;
  const float first = std::max(std::ceil(out.y - reach - 0.5F), 0.0F);
  const float last = std::min(std::floor(out.y + reach - 0.5F), static_cast<float>(camera.height) - 1);
  if (!(first <= last)) return {};
  out.first_row = static_cast<std::int32_t>(first);
  out.last_row = static_cast<std::int32_t>(last);
  for (std::int32_t row = out.first_row; row <= out.last_row; ++row) {
    const Span span = span_of(out, row, static_cast<std::int32_t>(camera.width));
    if (span.first <= span.last) return out;
  }
  return {};
}

/// Those that reach a pixel, near to far.
std::vector<Record> project_all(const GaussiansView& gaussians, const Camera& camera,
                                const raster::RenderOptions& options) {
  const Rigid camera_from_world = inverse(camera.world_from_camera);
  const glm::mat3 rotation = glm::mat3_cast(camera_from_world.rotation);
  tbb::combinable<std::vector<Record>> parts;
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, gaussians.count, 4096), [&](const auto& range) {
    std::vector<Record>& part = parts.local();
    for (std::size_t i = range.begin(); i < range.end(); ++i) {
      const auto record = project_gaussian(gaussians, i, camera, rotation, camera_from_world.translation, options);
      if (record) part.push_back(*record);
    }
  });
  std::vector<Record> records;
  parts.combine_each([&](const std::vector<Record>& part) { records.insert(records.end(), part.begin(), part.end()); });
  tbb::parallel_sort(records.begin(), records.end(), [](const Record& a, const Record& b) {
    return a.depth != b.depth ? a.depth < b.depth : a.gaussian < b.gaussian;
  });
  return records;
}

/// One row of tiles.
class Strip {
 public:
  Strip(const Camera& camera, std::uint32_t tile_side, std::uint32_t index)
      : width_(static_cast<std::int32_t>(camera.width)),
        side_(static_cast<std::int32_t>(tile_side)),
        top_(static_cast<std::int32_t>(index) * side_),
        bottom_(std::min(top_ + side_, static_cast<std::int32_t>(camera.height))),
        transmittance_(static_cast<std::size_t>(width_) * static_cast<std::size_t>(bottom_ - top_), 1.0F),
        spans_(static_cast<std::size_t>(side_)) {}

  void blend(const Record& r, Marks& blended) {
    const std::int32_t begin = std::max(r.first_row, top_), end = std::min(r.last_row + 1, bottom_);
    if (begin >= end) return;
    std::int32_t first = width_, last = -1;
    for (std::int32_t row = begin; row < end; ++row) {
      const Span span = span_of(r, row, width_);
      spans_[static_cast<std::size_t>(row - top_)] = span;
      if (span.last < span.first) continue;
      first = std::min(first, span.first);
      last = std::max(last, span.last);
    }
    bool any = false;
    for (std::int32_t tile = first / side_; tile <= last / side_ && first <= last; ++tile) {
      std::size_t taken = 0;
      bool reached = false;
      for (std::int32_t row = begin; row < end; ++row) {
        const Span span = spans_[static_cast<std::size_t>(row - top_)];
        const Span part{std::max(span.first, tile * side_), std::min(span.last, (tile + 1) * side_ - 1)};
        if (part.last < part.first) continue;
        reached = true;
        taken += blend_row(r, row, part);
      }
      counts.pairs += reached ? 1 : 0;
      counts.blended_pairs += taken > 0 ? 1 : 0;
      counts.evaluations += static_cast<double>(taken);
      any = any || taken > 0;
    }
    if (any) mark(blended, r.gaussian);
  }

  Census counts;

 private:
  std::size_t blend_row(const Record& r, std::int32_t row, Span span) {
    float* transmittance = transmittance_.data() + static_cast<std::ptrdiff_t>(row - top_) * width_;
    const float dy = static_cast<float>(row) + 0.5F - r.y, v = r.uyy * dy;
    std::size_t taken = 0;
    for (std::int32_t x = span.first; x <= span.last; ++x) {
      if (transmittance[x] < kTransmittanceMin) continue;
      const float u = r.uxx * (static_cast<float>(x) + 0.5F - r.x) + r.uxy * dy;
      const float alpha = std::min(kAlphaMax, std::exp2(r.log2_alpha - u * u - v * v));
      transmittance[x] -= alpha * transmittance[x];
      ++taken;
    }
    return taken;
  }

  std::int32_t width_, side_, top_, bottom_;
  std::vector<float> transmittance_;
  std::vector<Span> spans_;
};

std::size_t count_marks(const Marks& marks) {
  return static_cast<std::size_t>(std::count(marks.begin(), marks.end(), std::uint8_t{1}));
}

}  // namespace

Census& Census::operator+=(const Census& o) {
  gaussians += o.gaussians;
  views += o.views;
  pixels += o.pixels;
  listed_records += o.listed_records;
  listed_gaussians += o.listed_gaussians;
  pairs += o.pairs;
  evaluations += o.evaluations;
  blended_records += o.blended_records;
  blended_gaussians += o.blended_gaussians;
  blended_pairs += o.blended_pairs;
  return *this;
}

Census& Census::operator/=(double divisor) {
  gaussians /= divisor;
  views /= divisor;
  pixels /= divisor;
  listed_records /= divisor;
  listed_gaussians /= divisor;
  pairs /= divisor;
  evaluations /= divisor;
  blended_records /= divisor;
  blended_gaussians /= divisor;
  blended_pairs /= divisor;
  return *this;
}

Census take_census(const GaussiansView& gaussians, std::span<const Camera> cameras, std::uint32_t tile_side,
                   const raster::RenderOptions& options) {
  Census census;
  census.gaussians = static_cast<double>(gaussians.count);
  census.views = static_cast<double>(cameras.size());
  Marks listed(gaussians.count, 0), blended(gaussians.count, 0);
  for (const Camera& camera : cameras) {
    census.pixels += static_cast<double>(camera.width) * camera.height;
    const std::vector<Record> records = project_all(gaussians, camera, options);
    for (const Record& record : records) listed[record.gaussian] = 1;
    Marks blended_here(gaussians.count, 0);
    tbb::combinable<Census> counts;
    tbb::parallel_for(std::uint32_t{0}, (camera.height + tile_side - 1) / tile_side, [&](std::uint32_t row) {
      Strip strip(camera, tile_side, row);
      for (const Record& record : records) strip.blend(record, blended_here);
      counts.local() += strip.counts;
    });
    counts.combine_each([&](const Census& part) { census += part; });
    census.listed_records += static_cast<double>(records.size());
    census.blended_records += static_cast<double>(count_marks(blended_here));
    for (std::size_t i = 0; i < gaussians.count; ++i) blended[i] |= blended_here[i];
  }
  census.listed_gaussians = static_cast<double>(count_marks(listed));
  census.blended_gaussians = static_cast<double>(count_marks(blended));
  return census;
}

Census mean_census(const GaussiansView& gaussians, std::span<const Camera> cameras, std::size_t batch,
                   std::uint32_t tile_side) {
  const std::size_t batches = std::lcm(cameras.size(), batch) / batch;
  Census sum;
  for (std::size_t k = 0; k < batches; ++k) {
    std::vector<Camera> views;
    for (std::size_t b = 0; b < batch; ++b) views.push_back(cameras[(k * batch + b) % cameras.size()]);
    sum += take_census(gaussians, views, tile_side);
  }
  return sum /= static_cast<double>(batches);
}

}  // namespace splatbus::bench
