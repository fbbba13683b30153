#pragma once

#include <array>
#include <atomic>
#include <cmath>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "../../bus/bus_fixture.h"
#include "../../model/paged_publisher.h"
#include "../../stream/toy_model.h"
#include "bus/handover.h"
#include "bus/service.h"
#include "streamer/parameters.h"
#include "streamer/streamer.h"
#include "viewer/stream_client.h"
#include "wire/convert.h"
#include "wire/model_generated.h"
#include "wire/scene_generated.h"

namespace splatbus::stream_test {

/// Two viewers hold the same pages at the same versions, lane by lane.
inline bool hold_the_same(const stream::Replica& a, const stream::Replica& b) {
  if (a.held_pages() != b.held_pages() || a.count() != b.count()) return false;
  for (const auto& [number, page] : a.held().pages) {
    if (!(a.held().lanes(page) == b.held().lanes(*b.held().find(number)))) return false;
  }
  return true;
}

/// Ids by row, known by where the Gaussians are: viewers are sent none. Where two are in one place neither is known.
inline std::map<std::uint32_t, std::uint64_t> ids_by_row(const stream::Replica& replica, const GaussiansBuffer& model) {
  const stream::ReplicatedState& held = replica.held();
  const stream::Quantizer mean = held.layout.at(stream::Attribute::Mean).quantizer;
  std::map<std::array<std::int32_t, 3>, std::uint64_t> id_at;
  for (std::size_t i = 0; i < model.count(); ++i) {
    std::array<std::int32_t, 3> place{};
    for (std::size_t c = 0; c < 3; ++c) {
      place[c] =
          static_cast<std::int32_t>(std::lround((model.parameters[c * model.stride() + i] - mean.offset) / mean.step));
    }
    if (!id_at.emplace(place, model.gaussian_id[i]).second) id_at[place] = 0;
  }
  std::map<std::uint32_t, std::uint64_t> ids;
  for (const auto& [number, page] : held.pages) {
    for (std::uint32_t lane = 0; lane < page.count; ++lane) {
      const std::uint32_t row = page.row(lane);
      const auto& planes = held.gaussians.channels;
      if (const auto found = id_at.find({planes[0][row], planes[1][row], planes[2][row]});
          found != id_at.end() && found->second != 0) {
        ids[row] = found->second;
      }
    }
  }
  return ids;
}

/// Publishes models as the trainer does, in memory of some kind.
class FakeTrainer {
 public:
  explicit FakeTrainer(const std::shared_ptr<bus::Context>& context, Device kind = Device::Cpu)
      : publisher_(context), pages_(context, kind) {}

  /// Returns the index of each Gaussian.
  std::vector<std::uint32_t> publish(const GaussiansBuffer& model) {
    return pages_.publish(publisher_, model, ++generation_);
  }
  [[nodiscard]] std::uint64_t generation() const { return generation_; }
  /// All pages of what is published from now on are frozen, or none is.
  void freeze(bool frozen) { pages_.frozen = frozen; }

  /// Of replicas of relight that share the pages, one's part: what `of_index` has for other pages says nothing.
  struct Part {
    std::vector<std::uint32_t> pages;
    std::uint32_t page_indices = kPageLanes;
  };

  /// As relight does, by index.
  void publish_visibility(const std::vector<std::uint8_t>& of_index, std::uint64_t generation, std::uint64_t version,
                          const std::vector<std::uint32_t>& light_ids = {0}, const std::optional<Part>& part = {}) {
    const std::size_t indices = of_index.size() / light_ids.size();
    const bus::OutgoingTensor visibility{
        .name = "visibility",
        .shape = {static_cast<std::uint32_t>(light_ids.size()), static_cast<std::uint32_t>(indices)},
        .type = bus::ElementType::U8,
        .inline_data = of_index.data()};
    publisher_.publish(topics::kRelightVisibility, {.tensors = {visibility}}, [&](auto& builder, auto header) {
      const auto ids_at = builder.CreateVector(light_ids);
      if (!part) return wire::CreateRelightVisibility(builder, header, generation, version, indices, ids_at);
      return wire::CreateRelightVisibility(builder, header, generation, version, indices, ids_at, 2, 0, 1,
                                           part->page_indices, builder.CreateVector(part->pages));
    });
  }

  void publish_light(const Light& light) { publish_scene({.light = light, .objects = {}, .version = ++version_}); }

  void publish_scene(const SceneState& scene, std::int64_t capture_ns = 0) {
    publisher_.publish(topics::kSceneState, {.capture_ns = capture_ns}, [&](auto& builder, auto header) {
      return wire::CreateSceneUpdate(builder, header, to_wire(builder, scene));
    });
  }

 private:
  bus::Publisher publisher_;
  model::PagedPublisher pages_;
  std::uint64_t generation_ = 0, version_ = 0;
};

/// A streamer on a thread of its own.
class RunningStreamer {
 public:
  RunningStreamer(std::shared_ptr<bus::Context> context,
                  const std::vector<std::pair<std::string, std::string>>& changes, Device backend = Device::Cpu)
      : parameters_(bus::Parameters::declare<streamer::Options>()) {
    for (const auto& [name, value] : changes) EXPECT_EQ(parameters_.set(name, value, false), "");
    service_ = std::make_unique<bus::ServiceContext>(std::move(context), parameters_, stop_.get_token(), backend);
    streamer_ = std::make_unique<streamer::Streamer>(*service_);
    endpoints_ = streamer_->endpoints();
    thread_ = std::thread([this] { streamer_->run(); });
  }
  ~RunningStreamer() {
    stop_.request_stop();
    thread_.join();
  }
  RunningStreamer(const RunningStreamer&) = delete;
  RunningStreamer& operator=(const RunningStreamer&) = delete;

  [[nodiscard]] const std::vector<std::string>& endpoints() const { return endpoints_; }

 private:
  bus::Parameters parameters_;
  std::stop_source stop_;
  std::unique_ptr<bus::ServiceContext> service_;
  std::unique_ptr<streamer::Streamer> streamer_;
  std::vector<std::string> endpoints_;
  std::thread thread_;
};

/// A streamer under the test's own clock, which moves only in turns.
class SteppedStreamer {
 public:
  SteppedStreamer(std::shared_ptr<bus::Context> context,
                  const std::vector<std::pair<std::string, std::string>>& changes)
      : parameters_(bus::Parameters::declare<streamer::Options>()) {
    for (const auto& [name, value] : changes) EXPECT_EQ(parameters_.set(name, value, false), "");
    service_ = std::make_unique<bus::ServiceContext>(std::move(context), parameters_, stop_.get_token(), Device::Cpu);
    streamer_ = std::make_unique<streamer::Streamer>(*service_);
  }

  /// A turn after `passed_s` seconds.
  void turn(double passed_s) {
    now_ns_ += static_cast<std::int64_t>(passed_s * 1e9);
    streamer_->turn(now_ns_);
  }
  [[nodiscard]] const std::string& endpoint() const { return streamer_->endpoints().front(); }

 private:
  bus::Parameters parameters_;
  std::stop_source stop_;
  std::unique_ptr<bus::ServiceContext> service_;
  std::unique_ptr<streamer::Streamer> streamer_;
  std::int64_t now_ns_ = 1'000'000'000'000;
};

/// Broker, fake trainer and streamer.
class StreamTest : public bus_test::BusTest {
 protected:
  explicit StreamTest(Device trainer = Device::Cpu) : trainer_(connect("trainer"), trainer) {}

  void start_streamer(std::vector<std::pair<std::string, std::string>> changes = {}, Device backend = Device::Cpu) {
    changes.insert(changes.begin(), {"tick_hz", "50"});
    changes.insert(changes.begin(), {"coarseness", "-20"});  // ids_by_row() knows them by where they are
    changes.insert(changes.begin(), {"budget_kbps", "1000000"});
    changes.insert(changes.begin(), {"viewer_kbps", "1000000"});
    streamer_ = std::make_unique<RunningStreamer>(connect("streamer"), changes, backend);
  }

  /// The next one finds nothing of it.
  void kill_streamer() {
    streamer_.reset();
    (void)bus::take_handover(*connect("streamer"), [](std::span<const std::byte>) {});
  }

  [[nodiscard]] std::string endpoint() const { return streamer_->endpoints().front(); }

  [[nodiscard]] viewer::ClientOptions client_options(const std::string& name) const {
    return {.endpoint = endpoint(),
            .name = name,
            .hello_every_ns = 20'000'000,
            .silence_ns = 1'500'000'000,
            .pose_every_ns = 0};
  }

  /// Polls clients until the condition holds.
  template <class... Clients>
  static bool poll_until(const std::function<bool()>& condition, Clients&... clients) {
    const auto deadline = std::chrono::steady_clock::now() + bus_test::patience;
    while (!condition()) {
      (clients.poll(std::chrono::milliseconds(1)), ...);
      if (std::chrono::steady_clock::now() > deadline) return false;
    }
    return true;
  }

  FakeTrainer trainer_;
  std::unique_ptr<RunningStreamer> streamer_;
};

}  // namespace splatbus::stream_test
