#include "stream/held_hash.h"

#include "stream/scene_codec.h"

namespace splatbus::stream {

namespace {

class Hash {
 public:
  void add(std::uint64_t value) { value_ = (value_ ^ value) * 0x100000001B3ULL; }
  template <class Values>
  void add_all(const Values& values) {
    add(values.size());
    for (const auto value : values) add(static_cast<std::uint64_t>(value));
  }
  [[nodiscard]] std::uint64_t value() const { return value_; }

 private:
  std::uint64_t value_ = 0xCBF29CE484222325ULL;
};

}  // namespace

std::uint64_t held_hash(const ReplicatedState& state) {
  Hash hash;
  hash.add(state.epoch);
  hash.add(state.sequence);
  hash.add(state.visibility_version);
  for (const auto& plane : state.gaussians.channels) hash.add_all(plane);
  hash.add_all(state.gaussians.object_id);
  hash.add_all(state.gaussians.gaussian_id);
  for (const auto& [id, row] : state.light_rows.all()) {
    hash.add(id);
    hash.add_all(row);
  }
  hash.add(state.quantized_scene.version);
  hash.add_all(encode_scene(state.quantized_scene, nullptr));
  return hash.value();
}

}  // namespace splatbus::stream
