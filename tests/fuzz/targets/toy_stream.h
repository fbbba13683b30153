#pragma once

#include <string>
#include <vector>

#include "../../unit/stream/toy_model.h"
#include "stream/stream_model.h"
#include "toy_scene.h"

namespace splatbus::fuzz {

/// A streamer's model of some Gaussians in two pages, the same in every run, and the packets that follow it
/// as it moves.
class ToyStream {
 public:
  static constexpr std::uint64_t kEpoch = 77;

  explicit ToyStream(std::size_t gaussians = 60) : model_(stream::test::toy_model(gaussians, 1)) {
    (void)stream_.take_scene(toy_scene(1), {});
    stream_.observe(model_.view());
    stream_.reset_to_target();
    see(255);
  }

  stream::StreamModel& model() { return stream_; }

  /// All that there is, to somebody who holds nothing.
  std::vector<stream::EncodedPacket> join() {
    std::vector<stream::EncodedPacket> all{welcome(), stream_.layout_packet(), *stream_.scene_packet()};
    const auto offered = stream_.offered();
    for (auto& packet : stream_.manifest_packets(*offered, {}, true)) all.push_back(std::move(packet));
    for (const stream::OfferedPage& page : *offered) {
      for (auto& part : stream_.page_packets(page.page)) all.push_back(std::move(part.packet));
    }
    std::uint64_t sequence = 0;
    for (std::size_t i = 1; i < all.size(); ++i) stream::set_sequence(all[i], ++sequence);
    return all;
  }

  /// Gaussians move, some go, some come.
  stream::StreamUpdate tick() {
    for (std::size_t i = 0; i < model_.parameters.size(); i += 7) model_.parameters[i] += 0.01F;
    const std::size_t first = model_.count() - 40;
    for (std::size_t i = first; i < first + 10; ++i) model_.gaussian_id[i] += 10'000;
    stream_.observe(model_.view());
    stream_.make_tick(1e9, {});
    return stream_.take_update();
  }
  std::vector<stream::VisibilityPacket> see(std::uint8_t value) {
    static constexpr std::uint32_t kSun = 0;
    const std::vector<std::uint8_t> seen(model_.count(), value);
    return stream_.take_visibility(
        {.light_ids = {&kSun, 1}, .of_index = seen, .scene_version = stream_.scene_version()});
  }
  std::optional<stream::EncodedPacket> move() {
    return stream_.take_scene(toy_scene(stream_.scene_version() + 1), {.frame = 3, .capture_ns = 5});
  }

  [[nodiscard]] static const stream::PacketWriter& writer() {
    static const stream::PacketWriter made("streamer", 1);
    return made;
  }
  [[nodiscard]] static stream::EncodedPacket welcome() {
    return writer().write(kEpoch, 0, wire::Body::Welcome, [](auto& builder) {
      return wire::CreateWelcome(builder, wire::Appearance::Transfer, 0, kEpoch, 5, false, 1);
    });
  }

 private:
  stream::StreamModel stream_{writer(), kEpoch};
  GaussiansBuffer model_;
};

}  // namespace splatbus::fuzz
