#include "bench/codec_scene.h"

#include <flatbuffers/flatbuffers.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <numbers>
#include <numeric>

#include "raster/rasterizer.h"
#include "splats/file.h"
#include "stream/codecs.h"
#include "stream/display_gaussians.h"
#include "stream/model_quantizer.h"
#include "stream/replicated_state.h"
#include "world/gathered_model.h"

namespace splatbus::bench {

namespace {

constexpr std::uint32_t kSide_px = 512;

GaussiansBuffer gathered(const GaussiansBuffer& from, const ParameterLayout& layout,
                         const std::vector<std::uint32_t>& order) {
  GaussiansBuffer to(layout, order.size());
  for (int c = 0; c < layout.channels(); ++c) {
    for (std::size_t i = 0; i < order.size(); ++i) {
      to.parameters[static_cast<std::size_t>(c) * to.stride() + i] = from.view().plane(c)[order[i]];
    }
  }
  return to;
}

/// Ids as an importer numbers a file's Gaussians.
void load_ply(const std::string& path, int degree, std::size_t page_gaussians, CodecScene& scene) {
  const GaussiansBuffer whole = splats::read_file(path, splats::Axes::Keep).gaussians;
  ParameterLayout layout = whole.layout();
  if (degree >= 0) layout.sh_degree = std::min(degree, layout.sh_degree);
  const stream::StreamLayout grid(whole.layout(), 1.0F / 1024);
  stream::ModelQuantizer quantizer(Device::Cpu);
  stream::QuantizedGaussians integers;
  std::vector<std::uint8_t> usable;
  (void)quantizer.ids(whole.view());
  quantizer.quantize(whole.view(), grid, nullptr, {});
  quantizer.commit(integers, usable);
  std::vector<std::uint32_t> all;
  for (std::uint32_t i = 0; i < usable.size(); ++i) {
    if (usable[i] != 0) all.push_back(i);
  }
  const std::vector<std::uint32_t> order = stream::morton_order(integers, grid, all);
  scene.model = gathered(whole, layout, order);
  for (std::size_t i = 0; i < order.size(); ++i) scene.model.gaussian_id[i] = order[i] + 1;
  for (std::size_t end = page_gaussians; end < order.size(); end += page_gaussians) scene.page_ends.push_back(end);
  scene.page_ends.push_back(order.size());
}

void load_world(const std::string& path, CodecScene& scene) {
  world::World folder{std::filesystem::path(path)};
  world::GatheredModel gathered = world::gather_model(folder);
  scene.model = std::move(gathered.gaussians);
  scene.page_ends = std::move(gathered.page_ends);
}

/// Between which all but a fiftieth of the means lie.
std::pair<glm::vec3, glm::vec3> extent(const GaussiansBuffer& model) {
  glm::vec3 low, high;
  for (int c = 0; c < 3; ++c) {
    std::vector<float> values(model.view().plane(c), model.view().plane(c) + model.count());
    std::ranges::sort(values);
    low[c] = values[values.size() / 50];
    high[c] = values[values.size() - 1 - values.size() / 50];
  }
  return {low, high};
}

/// On two rings around the middle, half of the model's size and once its size away.
std::vector<Camera> cameras_around(const GaussiansBuffer& model) {
  const auto [low, high] = extent(model);
  const glm::vec3 middle = 0.5F * (low + high);
  const float radius = 0.5F * glm::distance(low, high);
  std::vector<Camera> cameras;
  for (int k = 0; k < 8; ++k) {
    const float angle = 2 * std::numbers::pi_v<float> * static_cast<float>(k) / 8;
    const float distance = radius * (k % 2 == 0 ? 1.0F : 1.8F), height = radius * (k % 4 < 2 ? 0.35F : 0.8F);
    const glm::vec3 eye = middle + glm::vec3(distance * std::cos(angle), height, distance * std::sin(angle));
    cameras.push_back(look_at(eye, middle, kSide_px, kSide_px, 0.9F));
    cameras.back().near_m = 1e-3F * radius;
  }
  return cameras;
}

}  // namespace

CodecScene load_codec_scene(const std::string& path, int degree, std::size_t page_gaussians) {
  CodecScene scene;
  scene.name = std::filesystem::path(path).stem().string();
  if (std::filesystem::is_directory(path)) {
    load_world(path, scene);
  } else {
    load_ply(path, degree, page_gaussians, scene);
  }
  if (scene.model.count() == 0) throw std::runtime_error(path + ": no Gaussians");
  scene.cameras = cameras_around(scene.model);
  scene.scene.light.ambient_sh[0] = glm::vec3(1.5F);
  scene.scene.light.sun_direction = glm::normalize(glm::vec3(0.3F, 1, 0.2F));
  scene.scene.light.sun_irradiance = glm::vec3(1.2F);
  return scene;
}

stream::StreamLayout layout_with(const stream::StreamLayout& layout, const std::vector<float>& steps) {
  flatbuffers::FlatBufferBuilder builder;
  std::vector<flatbuffers::Offset<wire::TensorMetadata>> attributes;
  for (std::size_t k = 0; k < layout.attributes().size(); ++k) {
    const stream::AttributeChannels& a = layout.attributes()[k];
    const float step = k < steps.size() && steps[k] > 0 ? steps[k] : a.quantizer.step;
    const wire::Quantizer quantizer(a.quantizer.offset, step);
    attributes.push_back(
        wire::CreateTensorMetadata(builder, a.attribute, static_cast<std::uint32_t>(a.channels), &quantizer));
  }
  const auto list = builder.CreateVector(attributes);
  const bool transfer = layout.parameters().appearance == Appearance::Transfer;
  builder.Finish(wire::CreateLayout(builder, transfer ? wire::Appearance::Transfer : wire::Appearance::Radiance,
                                    static_cast<std::uint8_t>(layout.parameters().sh_degree), list, kPageLanes));
  return stream::StreamLayout::from_wire(*flatbuffers::GetRoot<wire::Layout>(builder.GetBufferPointer()));
}

Pictures::Pictures(const CodecScene& scene) : scene_(scene), truth_(draw(scene.model.view())) {}

std::vector<float> Pictures::draw(const GaussiansView& gaussians) const {
  const auto rasterizer = raster::make_cpu_rasterizer(0);
  const bool linear = gaussians.layout.appearance == Appearance::Transfer;
  std::vector<float> pixels;
  raster::Render render;
  for (const Camera& camera : scene_.cameras) {
    rasterizer->render(gaussians, camera, scene_.scene, {}, render);
    for (const float value : render.color.data) {
      const float bounded = std::clamp(value, 0.0F, 1.0F);
      pixels.push_back(linear ? srgb_from_linear(bounded) : bounded);
    }
  }
  return pixels;
}

double Pictures::psnr_db(const stream::QuantizedGaussians& gaussians, const stream::StreamLayout& layout) const {
  stream::DisplayChanges changes;
  changes.add(stream::DisplayReset{layout});
  std::vector<std::uint32_t> rows(gaussians.count());
  std::iota(rows.begin(), rows.end(), 0U);
  changes.add(stream::DisplayRows{rows, gaussians});
  stream::DisplayBlocks blocks;
  for (std::uint32_t first = 0; first < rows.size(); first += stream::kBlockRows) {
    const auto count = std::min<std::size_t>(stream::kBlockRows, rows.size() - first);
    blocks.blocks.push_back({first / stream::kBlockRows, static_cast<std::uint32_t>(count)});
  }
  changes.add(std::move(blocks));
  stream::DisplayGaussians shown;
  shown.apply(changes);
  const std::vector<float> picture = draw(shown.view());
  double squares = 0;
  for (std::size_t i = 0; i < picture.size(); ++i) squares += std::pow(double{picture[i]} - truth_[i], 2.0);
  return 10 * std::log10(static_cast<double>(picture.size()) / squares);
}

}  // namespace splatbus::bench
