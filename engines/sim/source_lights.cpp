#include "sim/source_lights.h"

#include <algorithm>
#include <glm/gtc/constants.hpp>
#include <optional>

#include "sim/light_maps.h"

namespace splatbus::sim {
namespace {

std::uint32_t maps_of(const splatbus_light_source& source) {
  if (source.casts_shadow == 0) return 0;
  return source.kind == SPLATBUS_LIGHT_POINT ? 6 : 1;
}

glm::vec3 vec(const float (&v)[3]) {
  return {v[0], v[1], v[2]};
}

}  // namespace

SourceLights::SourceLights(int local_size, int directional_size, const Bounds& bounds)
    : local_size_(local_size), directional_size_(directional_size), bounds_(bounds) {}

void SourceLights::lay_out(std::span<const splatbus_light_source> sources) {
  const bool same = std::ranges::equal(places_, sources, [](const Place& place, const splatbus_light_source& source) {
    return place.id == source.id && place.kind == source.kind && place.maps == maps_of(source);
  });
  if (same) return;
  places_.clear();
  int local = 0, directional = 0;
  for (const splatbus_light_source& source : sources) {
    int& layers = source.kind == SPLATBUS_LIGHT_DIRECTIONAL ? directional : local;
    places_.push_back(
        {.id = source.id, .kind = source.kind, .maps = maps_of(source), .first_layer = layers, .camera = {}});
    layers += static_cast<int>(places_.back().maps);
  }
  // A texture that is bound has a layer, which nothing samples where no light has one.
  local_.resize(local > 0 ? local_size_ : 1, std::max(local, 1));
  directional_.resize(directional > 0 ? directional_size_ : 1, std::max(directional, 1));
}

void SourceLights::draw_maps(GpuScene& scene, const splatbus_light& light, Place& place,
                             const DepthPrograms& program_for) {
  DepthMaps& depth = place.kind == SPLATBUS_LIGHT_DIRECTIONAL ? directional_ : local_;
  splatbus_camera_request request{};
  request.camera.width = request.camera.height = static_cast<std::uint32_t>(depth.size());
  request.light_id = place.id;
  for (std::uint32_t map = 0; map < place.maps; ++map) {
    request.light_map = map;
    const std::optional<LightCamera> camera = light_camera(request, {light, bounds_});
    if (!camera) continue;
    if (map == 0) place.camera = map_camera(*camera);
    depth.draw(place.first_layer + static_cast<int>(map), scene, *camera, program_for);
    ++maps_drawn_;
  }
}

void SourceLights::update(GpuScene& scene, const splatbus_light& light, const DepthPrograms& program_for) {
  const std::span sources(light.sources, light.source_count);
  lay_out(sources);
  const auto is_local = [](const splatbus_light_source& source) { return source.kind != SPLATBUS_LIGHT_DIRECTIONAL; };
  std::size_t local = 0, directional = static_cast<std::size_t>(std::ranges::count_if(sources, is_local));
  block_.count = {static_cast<std::int32_t>(directional), static_cast<std::int32_t>(sources.size())};
  for (std::size_t i = 0; i < sources.size(); ++i) {
    const splatbus_light_source& source = sources[i];
    Place& place = places_[i];
    if (place.drawn_version != source.depth_version) draw_maps(scene, light, place, program_for);
    place.drawn_version = source.depth_version;
    block_.sources.at(is_local(source) ? local++ : directional++) = {
        .position_range = {vec(source.position), source.range_m},
        .direction_kind = {vec(source.direction), static_cast<float>(source.kind)},
        .intensity_layer = {vec(source.intensity) / glm::pi<float>(),
                            place.maps > 0 ? static_cast<float>(place.first_layer) : -1},
        .cone = {source.cos_outer, 1 / (source.cos_inner - source.cos_outer), 0, 0},
        .map = place.camera};
  }
  if (!buffer_) {
    buffer_ = make_buffer();
    glNamedBufferStorage(buffer_.get(), sizeof(Block), nullptr, GL_DYNAMIC_STORAGE_BIT);
  }
  glNamedBufferSubData(buffer_.get(), 0, sizeof(Block), &block_);
}

void SourceLights::bind() const {
  glBindBufferBase(GL_UNIFORM_BUFFER, kSourcesBinding, buffer_.get());
  glBindTextureUnit(kLocalMaps, local_.layers());
  glBindTextureUnit(kDirectionalMaps, directional_.layers());
}

}  // namespace splatbus::sim
