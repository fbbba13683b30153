#include "bench/bench_scene.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <glm/gtc/quaternion.hpp>
#include <numeric>
#include <random>
#include <stdexcept>

#include "splats/file.h"

namespace splatbus::bench {
namespace {

/// "world_to_camera": 4x4 rows, "intrinsics": 3x3 rows, OpenCV axes.
std::vector<Camera> read_cameras(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error(path + ": cannot be opened");
  const nlohmann::json document = nlohmann::json::parse(file);
  std::vector<Camera> cameras;
  for (std::size_t k = 0; k < document.at("world_to_camera").size(); ++k) {
    const auto& m = document["world_to_camera"][k];
    const auto& intrinsics = document.at("intrinsics").at(k);
    Camera camera;
    camera.width = document.at("width");
    camera.height = document.at("height");
    camera.fx = intrinsics[0][0];
    camera.fy = intrinsics[1][1];
    camera.cx = intrinsics[0][2];
    camera.cy = intrinsics[1][2];
    glm::mat3 rotation;
    glm::vec3 translation;
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 3; ++column) rotation[column][row] = m[row][column];
      translation[row] = m[row][3];
    }
    camera.world_from_camera = inverse(Rigid{glm::normalize(glm::quat_cast(rotation)), translation});
    cameras.push_back(camera);
  }
  return cameras;
}

/// The scene in the layout asked for: fewer SH bands, or as a transfer model with its DC colour as albedo.
GaussiansBuffer convert(const GaussiansBuffer& from, const Arguments& arguments) {
  const ParameterLayout layout = arguments.appearance == "transfer"
                                     ? ParameterLayout{Appearance::Transfer, 0}
                                     : ParameterLayout{Appearance::Radiance, arguments.sh};
  GaussiansBuffer to(layout, from.count());
  const GaussiansView source = from.view();
  const int shared = std::min(layout.channels(), from.layout().channels());
  for (int c = 0; c < (layout.appearance == Appearance::Transfer ? 11 : shared); ++c) {
    std::copy_n(source.plane(c), from.count(), to.parameters.data() + static_cast<std::size_t>(c) * to.stride());
  }
  for (std::size_t i = 0; i < from.count() && layout.appearance == Appearance::Transfer; ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      to.parameters[(11 + c) * to.stride() + i] = 0.5F + 0.28209479F * source.plane(11 + static_cast<int>(c))[i];
    }
    to.normal[2 * to.stride() + i] = 1;
    to.visibility[i] = 1;
  }
  return to;
}

}  // namespace

Workload::Workload(const Arguments& arguments)
    : model(convert(splats::read_file(arguments.scene, splats::Axes::Keep).gaussians, arguments)),
      cameras(read_cameras(arguments.cameras)),
      pages_(arguments.pages) {
  if (cameras.empty()) throw std::runtime_error(arguments.cameras + ": no cameras");
  for (int c = 0; c < 3; ++c) scene.light.ambient_sh[0][c] = 1 / 0.2820948F;
  scene.light.sun_irradiance = glm::vec3(1);
  if (arguments.copies > 1) model = stacked(model, cameras, arguments.copies);
  if (pages_ != "none") paged = PagedScene(model.view());
  add_sources(arguments.sources);
}

/// Points and spots by turns, at every so many of the Gaussians, whose light reaches all of them.
void Workload::add_sources(std::size_t count) {
  if (count == 0 || model.count() == 0) return;
  const auto mean = [&](std::size_t i) {
    return glm::vec3(model.view().plane(0)[i], model.view().plane(1)[i], model.view().plane(2)[i]);
  };
  glm::vec3 low(INFINITY), high(-INFINITY);
  for (std::size_t i = 0; i < model.count(); ++i) {
    low = glm::min(low, mean(i));
    high = glm::max(high, mean(i));
  }
  const float extent_m = glm::distance(low, high);
  for (std::size_t j = 0; j < count; ++j) {
    const glm::vec3 at = mean(j * model.count() / count) + glm::vec3(0, 0.05F * extent_m, 0);
    scene.light.sources.push_back({.id = static_cast<std::uint32_t>(1 + j),
                                   .kind = j % 2 == 0 ? LightKind::Point : LightKind::Spot,
                                   .position = at,
                                   .direction = {0, -1, 0},
                                   .intensity = glm::vec3(0.01F * extent_m * extent_m),
                                   .range_m = 2 * extent_m,
                                   .cos_inner = 0.9F,
                                   .cos_outer = -1});
  }
  visibility.assign((1 + count) * view().count, 200);
}

void Workload::disturb() {
  std::mt19937 generator(1);
  const auto noise = [&] { return static_cast<float>(generator() >> 8U) / 8388608.0F - 1; };
  for (std::size_t i = 0; i < model.count(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      model.parameters[c * model.stride() + i] += 0.004F * noise();
      model.parameters[(11 + c) * model.stride() + i] += 0.1F * noise();
    }
  }
  if (pages_ != "none") paged = PagedScene(model.view());
}

GaussiansView Workload::view() const {
  GaussiansView out = pages_ == "none" ? model.view() : paged.view(pages_ == "seen");
  if (visibility.empty()) return out;
  out.visibility_u8 = visibility.data();
  out.visibility_stride = out.count;
  out.visibility_rows = static_cast<std::uint32_t>(1 + scene.light.sources.size());
  return out;
}

float* Workload::parameters() {
  return pages_ == "none" ? model.parameters.data() : paged.parameters();
}

std::vector<std::uint8_t> to_target(const raster::Image& image, bool linear) {
  const std::size_t pixels = std::size_t{image.width} * image.height;
  std::vector<std::uint8_t> rgba(4 * pixels, 255);
  for (std::size_t i = 0; i < pixels; ++i) {
    for (std::uint32_t c = 0; c < 3; ++c) {
      const float value = image.plane(c)[i];
      const float shown = linear ? srgb_from_linear(value) : std::clamp(value, 0.0F, 1.0F);
      rgba[4 * i + c] = static_cast<std::uint8_t>(std::lround(255 * shown));
    }
  }
  return rgba;
}

double mean_of(const raster::Image& image) {
  return std::accumulate(image.data.begin(), image.data.end(), 0.0) / static_cast<double>(image.data.size());
}

std::vector<float> learning_rates(const ParameterLayout& layout) {
  std::vector<float> rates(static_cast<std::size_t>(layout.channels()), 2.5e-3F / 20);
  std::fill_n(rates.begin(), 3, 1.6e-4F);
  std::fill_n(rates.begin() + 3, 3, 5e-3F);
  std::fill_n(rates.begin() + 6, 4, 1e-3F);
  rates[10] = 2.5e-2F;
  std::fill_n(rates.begin() + 11, 3, 2.5e-3F);
  return rates;
}

double median(std::vector<double> values) {
  if (values.empty()) return 0;
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2), values.end());
  return values[values.size() / 2];
}

nlohmann::json report(const Arguments& arguments, const Workload& workload, const std::vector<double>& milliseconds) {
  const double step_ms = median(milliseconds);
  return {{"gaussians", workload.model.count()},
          {"width", workload.cameras.at(0).width},
          {"height", workload.cameras.at(0).height},
          {"backend", arguments.backend},
          {"mode", arguments.mode},
          {"appearance", arguments.appearance},
          {"sh", workload.transfer() ? -1 : arguments.sh},
          {"active_channels", arguments.active_channels},
          {"batch", arguments.batch},
          {"pages", arguments.pages},
          {"sources", arguments.sources},
          {"page_lanes", arguments.pages == "none" ? 0 : kPageLanes},
          {"ms_median", step_ms},
          {"ms_min", *std::min_element(milliseconds.begin(), milliseconds.end())},
          {"views_per_s", 1000.0 * arguments.batch / step_ms}};
}

}  // namespace splatbus::bench
