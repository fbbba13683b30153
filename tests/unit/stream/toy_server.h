#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <deque>
#include <random>

#include "stream/replica.h"
#include "stream/stream_model.h"
#include "toy_model.h"

namespace splatbus::stream::test {

inline ParsedPacket parse(const EncodedPacket& packet) {
  return ParsedPacket::parse(packet.packet, packet.payload);
}

inline void send(const std::vector<EncodedPacket>& packets, Replica& replica) {
  for (const EncodedPacket& packet : packets) replica.receive(parse(packet));
}
inline void send(const std::optional<EncodedPacket>& packet, Replica& replica) {
  if (packet) replica.receive(parse(*packet));
}
inline void send(const std::vector<VisibilityPacket>& packets, Replica& replica) {
  for (const VisibilityPacket& packet : packets) replica.receive(parse(packet.packet));
}

/// Every page that the replica has otherwise, whole.
inline void send_pages(StreamModel& stream, Replica& replica, std::uint32_t part_lanes = kPageLanes) {
  const auto offered = stream.offered();
  for (const OfferedPage& page : *offered) {
    const HeldPage* held = replica.held().find(page.page);
    if (held && held->whole() && held->version == page.version) continue;
    for (const PagePacket& part : stream.page_packets(page.page, part_lanes)) replica.receive(parse(part.packet));
  }
}

/// All that there is, to somebody who holds nothing.
inline void join(StreamModel& stream, Replica& replica, std::uint32_t part_lanes = kPageLanes) {
  replica.receive(parse(stream.layout_packet()));
  send(stream.scene_packet(), replica);
  send(stream.manifest_packets(*stream.offered(), {}, true), replica);
  send_pages(stream, replica, part_lanes);
}

/// What a tick has made, in the order in which a viewer with room for all gets it.
inline std::vector<EncodedPacket> packets_of(StreamModel& stream) {
  std::vector<EncodedPacket> packets;
  StreamUpdate update = stream.take_update();
  for (DeltaPacket& delta : update.deltas) packets.push_back(std::move(delta.packet));
  if (!update.gone.empty()) packets.push_back(stream.gone_packet(update.gone));
  return packets;
}

/// A model that grows, shrinks and moves like a trained one, and its stream.
class ToyServer {
 public:
  explicit ToyServer(std::uint32_t seed, std::size_t count = 600, Appearance appearance = Appearance::Transfer,
                     const StreamOptions& options = {}, std::uint64_t epoch = 76, int sh_degree = 1)
      : stream(PacketWriter("streamer", 1), epoch, options),
        random_(seed),
        model_(toy_model(count, seed, 1, appearance, sh_degree)),
        next_id_(count + 1) {
    scene.light.sun_direction = {0, 1, 0};
    scene.light.generation = 1;
    scene.version = 1;
    sent_ = scene;
    EXPECT_FALSE(stream.take_scene(scene, {})) << "nobody holds anything yet";
    stream.observe(model_.view());
    stream.reset_to_target();
    (void)take_visibility(relit(), scene.version);
  }

  void insert(std::size_t count) {
    const GaussiansBuffer more = toy_model(count, static_cast<std::uint32_t>(random_()), next_id_,
                                           model_.layout().appearance, model_.layout().sh_degree);
    next_id_ += count;
    const std::size_t before = model_.count();
    model_.resize(before + count);
    for (std::size_t i = 0; i < count; ++i) copy(more, i, model_, before + i);
  }

  void remove(std::size_t count) {
    std::vector<std::uint8_t> gone(model_.count());
    for (std::size_t i = 0; i < count && i < gone.size(); ++i) gone[random_() % gone.size()] = 1;
    GaussiansBuffer kept(model_.layout(), static_cast<std::size_t>(std::ranges::count(gone, 0)));
    std::size_t to = 0;
    for (std::size_t i = 0; i < gone.size(); ++i) {
      if (!gone[i]) copy(model_, i, kept, to++);
    }
    model_ = kept;
  }

  void train(float amount) {
    std::normal_distribution<float> normal(0, amount);
    for (float& value : model_.parameters) value += normal(random_);
    for (std::size_t i = 0; i < model_.count(); ++i) {
      if (random_() % 50 == 0) model_.visibility[i] = 1 - model_.visibility[i];
      if (random_() % 500 == 0) model_.object_id[i] = static_cast<std::uint32_t>(random_() % 3);
    }
  }

  /// All but pages that are new or have to come whole: send_pages().
  std::vector<EncodedPacket> tick(double budget = 1e9) {
    std::vector<EncodedPacket> packets;
    if (scene.light != sent_.light || scene.objects != sent_.objects) packets = change_scene();
    EXPECT_TRUE(stream.observe(model_.view()));
    stream.make_tick(budget, {});
    for (EncodedPacket& packet : packets_of(stream)) packets.push_back(std::move(packet));
    for (VisibilityPacket& packet : take_visibility(relit(), scene.version))
      packets.push_back(std::move(packet.packet));
    return packets;
  }
  /// A tick, and what else a viewer gets of it.
  void tick_for(Replica& replica, double budget = 1e9) {
    send(tick(budget), replica);
    send_pages(stream, replica);
  }

  /// As relight says it: by index.
  [[nodiscard]] std::vector<std::uint8_t> relit() const {
    std::vector<std::uint8_t> visibility;
    for (const float v : model_.visibility) visibility.push_back(static_cast<std::uint8_t>(std::lround(255 * v)));
    visibility.resize(model_.count());
    return visibility;
  }

  /// The sun's alone.
  std::vector<VisibilityPacket> take_visibility(std::span<const std::uint8_t> of_index, std::uint64_t version) {
    return stream.take_visibility(of_sun(of_index, version));
  }
  static LightsVisibility of_sun(std::span<const std::uint8_t> of_index, std::uint64_t version) {
    static constexpr std::uint32_t kSun = 0;
    return {.light_ids = {&kSun, 1}, .of_index = of_index, .scene_version = version};
  }

  /// `scene` as the next version.
  std::vector<EncodedPacket> change_scene() {
    ++scene.version;
    sent_ = scene;
    std::vector<EncodedPacket> packets;
    if (auto packet = stream.take_scene(scene, {.frame = scene.version, .capture_ns = 5})) {
      packets.push_back(std::move(*packet));
    }
    return packets;
  }

  GaussiansBuffer& model() { return model_; }
  /// Ids of what is held, by page and lane: viewers hold none.
  [[nodiscard]] std::uint64_t id_at(std::uint32_t page, std::uint32_t lane) const {
    return stream.held().gaussians.gaussian_id[stream.held().find(page)->row(lane)];
  }

  StreamModel stream;
  SceneState scene;

 private:
  static void copy(const GaussiansBuffer& from, std::size_t i, GaussiansBuffer& to, std::size_t k) {
    for (int c = 0; c < from.layout().channels(); ++c) {
      to.parameters[static_cast<std::size_t>(c) * to.stride() + k] =
          from.parameters[static_cast<std::size_t>(c) * from.stride() + i];
    }
    for (std::size_t c = 0; c < 3; ++c) to.normal[c * to.stride() + k] = from.normal[c * from.stride() + i];
    to.visibility[k] = from.visibility[i];
    to.object_id[k] = from.object_id[i];
    to.gaussian_id[k] = from.gaussian_id[i];
  }

  std::mt19937 random_;
  GaussiansBuffer model_;
  std::uint64_t next_id_;
  SceneState sent_;
};

/// Calls visit(id, row) for every Gaussian of a replica that holds what the server offers.
template <class Visit>
void for_each_held(const ToyServer& server, const Replica& replica, const Visit& visit) {
  for (const auto& [number, page] : replica.held().pages) {
    for (std::uint32_t lane = 0; lane < page.count; ++lane) visit(server.id_at(number, lane), page.row(lane));
  }
}

}  // namespace splatbus::stream::test
