#include "stream/held_hash.h"

#include "stream/scene_codec.h"

namespace splatbus::stream {

namespace {

class Hash {
 public:
  void add(std::uint64_t value) { value_ = (value_ ^ value) * 0x100000001B3ULL; }
  [[nodiscard]] std::uint64_t value() const { return value_; }

 private:
  std::uint64_t value_ = 0xCBF29CE484222325ULL;
};

}  // namespace

std::uint64_t held_hash(const ReplicatedState& state) {
  Hash hash;
  hash.add(state.epoch);
  hash.add(state.visibility_version);
  for (const auto& entry : state.pages) {
    const HeldPage& page = entry.second;
    for (const std::uint32_t value : {entry.first, page.version, page.structure, page.count, page.missing})
      hash.add(value);
    const auto add_lanes = [&](const auto& values) {
      for (std::uint32_t lane = 0; lane < page.count; ++lane) {
        if ((page.missing >> (lane / kBlockRows) & 1U) == 0) {
          hash.add(static_cast<std::uint64_t>(values[page.row(lane)]));
        }
      }
    };
    for (const auto& plane : state.gaussians.channels) add_lanes(plane);
    add_lanes(state.gaussians.object_id);
    add_lanes(state.gaussians.gaussian_id);
    for (const auto& [id, row] : state.light_rows.all()) add_lanes(row);
  }
  hash.add(state.quantized_scene.version);
  for (const std::uint8_t byte : encode_scene(state.quantized_scene, nullptr)) hash.add(byte);
  return hash.value();
}

}  // namespace splatbus::stream
