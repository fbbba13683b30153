#include <fmt/format.h>

#include "stream/scene_codec.h"
#include "stream/stream_model.h"

namespace splatbus::stream {

std::vector<EncodedPacket> StreamModel::take_scene(const SceneState& scene, const SceneInstant& instant) {
  if (scene.version == 0 || scene.version < scene_.version) {
    throw StreamError(fmt::format("scene: version {} after {}", scene.version, scene_.version));
  }
  if (scene.version == scene_.version) return {};
  scene_ = quantize_scene(scene);
  instant_ = instant;
  if (!ready_) return {};
  ready_ = false;  // until the mirror has it too
  std::vector<EncodedPacket> out{scene_packet(held_.sequence + 1, &held_.quantized_scene)};
  take_packet(out.back());
  ready_ = true;
  return out;
}

EncodedPacket StreamModel::scene_packet(std::uint64_t sequence, const QuantizedScene* base) const {
  return brief_writer_.write(
      held_.epoch, sequence, wire::Body::Scene,
      [&](auto& builder) {
        const auto state = builder.CreateVector(encode_scene(scene_, base));
        return wire::CreateScene(builder, scene_.version, instant_.frame, base == nullptr, state);
      },
      {}, instant_.capture_ns);
}

void StreamModel::hold_scene() {
  held_.quantized_scene = scene_;
  held_.scene = dequantize_scene(scene_);
  held_.instant = instant_;
}

}  // namespace splatbus::stream
