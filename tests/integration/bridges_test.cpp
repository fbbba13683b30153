// Replicas of the capture-bridge: one leads, and the others sample rounds of its engines' pictures.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <stdexcept>
#include <string>
#include <tuple>
#include <vector>

#include "bus/subscriber.h"
#include "operated_bus.h"
#include "wire/capture_generated.h"
#include "wire/sampling_generated.h"
#include "wire/sampling_topics.h"
#include "wire/system_generated.h"

namespace splatbus::cli {
namespace {

constexpr std::chrono::seconds kPatience(90);
const std::string kFirst = "capture-bridge-1", kSecond = "capture-bridge-2", kThird = "capture-bridge-3";

constexpr const char* kLaunchFile = R"(
services:
  - name: bus
  - name: engine
    program: splatbus-engine-sim
    replicas: 2
    args: [--fps, "10", --shared-clock, --dynamics, --sun-rate, "6"]
  - name: capture-bridge
    replicas: 2
    parameters: {reference_cameras: 0, input_cameras: 8, input_size: 64, sample_budget: 4000, light_depth_size: 64}
)";

/// Who samples the rounds of capture/input, and who writes it.
class Rounds {
 public:
  explicit Rounds(const bus::Address& address) : subscriber_(bus::Context::create(address, "rounds")) {
    subscriber_
        .on(topics::kSamplingResult,
            [this](const wire::SamplingResult&, const bus::Message& message) {
              if (const auto place = place_of(message)) sampled_[*place] = message.header().source()->str();
            })
        .on(topics::kCaptureInput,
            [this](const wire::CaptureInput&, const bus::Message& message) {
              const std::string source = message.header().source()->str();
              if (writers.empty() || writers.back() != source) writers.push_back(source);
              const auto place = place_of(message);
              if (!place) return;
              twice += published_.insert(*place).second ? 0 : 1;
              const auto helped = sampled_.find(*place);
              ++by[helped == sampled_.end() ? source : helped->second];
            })
        .on(topics::kHeartbeat, [this](const wire::Heartbeat& heartbeat, const bus::Message& message) {
          std::map<std::string, double>& counters = counters_[message.header().source()->str()];
          counters.clear();
          for (const auto* counter : *heartbeat.counters()) counters[counter->name()->str()] = counter->value();
        });
  }
  void poll() { subscriber_.dispatch_all(std::chrono::milliseconds(20)); }
  [[nodiscard]] double counter(const std::string& process, const std::string& name) { return counters_[process][name]; }

  std::vector<std::string> writers;  ///< in their order
  std::map<std::string, int> by;     ///< published rounds, by who has sampled them
  int twice = 0;                     ///< samples that were published again

 private:
  /// Where its samples lie, and since when.
  using Place = std::tuple<std::uint64_t, std::uint64_t, std::uint64_t>;
  static std::optional<Place> place_of(const bus::Message& message) {
    const auto position = message.forward_tensor("position");
    if (!position) return std::nullopt;
    return Place(position->span.slab(), position->span.generation(), position->span.offset());
  }

  bus::Subscriber subscriber_;
  std::map<Place, std::string> sampled_;
  std::set<Place> published_;
  std::map<std::string, std::map<std::string, double>> counters_;
};

class Bridges : public OperatedBus {
 protected:
  void up_and_listen() {
    ASSERT_NO_FATAL_FAILURE(up(kLaunchFile));
    rounds_.emplace(folder_.address());
  }
  [[nodiscard]] pid_t pid_of(const std::string& name) const {
    const std::vector<nlohmann::json> lines = run({"status", "--json"}).json();
    for (const auto& process : lines.at(0).at("services")) {
      if (process.at("name") == name && process.value("pid", 0) > 0) return process.value("pid", 0);
    }
    throw std::runtime_error(name + " does not run");  // 0 is every process of this group
  }
  [[nodiscard]] bool until(const std::function<bool()>& condition) {
    for (const auto end = std::chrono::steady_clock::now() + kPatience; std::chrono::steady_clock::now() < end;) {
      rounds_->poll();
      if (condition()) return true;
    }
    return false;
  }
  /// From now on.
  [[nodiscard]] bool all_sample(const std::vector<std::string>& bridges) {
    rounds_->by.clear();
    return until(
        [&] { return std::ranges::all_of(bridges, [&](const auto& name) { return rounds_->by[name] >= 5; }); });
  }

  std::optional<Rounds> rounds_;
};

TEST_F(Bridges, ShareSamplingWhileAnyOfThemDiesIsStoppedComesOrGoes) {
  ASSERT_NO_FATAL_FAILURE(up_and_listen());
  ASSERT_TRUE(all_sample({kFirst, kSecond}));
  ASSERT_EQ(rounds_->writers.size(), 1U);
  const std::string lead = rounds_->writers.back(), helper = lead == kFirst ? kSecond : kFirst;

  // The one that helps dies, and is there again; then it is stopped, with a round in hand or not.
  ASSERT_EQ(kill(pid_of(helper), SIGKILL), 0);
  ASSERT_TRUE(all_sample({lead}));
  ASSERT_TRUE(all_sample({lead, helper}));
  const pid_t stopped = pid_of(helper);
  ASSERT_EQ(kill(stopped, SIGSTOP), 0);
  EXPECT_TRUE(until([&] { return rounds_->counter(lead, "helpers") == 0; }));
  EXPECT_TRUE(all_sample({lead}));
  kill(stopped, SIGCONT);  // unless the supervisor has started it again
  EXPECT_TRUE(all_sample({lead, helper}));
  EXPECT_EQ(rounds_->writers, std::vector<std::string>{lead});

  // The one that leads dies: the other does, and is helped.
  ASSERT_EQ(kill(pid_of(lead), SIGKILL), 0);
  ASSERT_TRUE(until([&] { return rounds_->writers.back() == helper; }));
  ASSERT_TRUE(all_sample({kFirst, kSecond}));
  EXPECT_EQ(rounds_->writers, (std::vector<std::string>{lead, helper}));

  expect_success({"scale", "capture-bridge=3"});
  EXPECT_TRUE(all_sample({kFirst, kSecond, kThird}));
  expect_success({"swap", "capture-bridge"});
  EXPECT_TRUE(all_sample({kFirst, kSecond, kThird}));
  expect_success({"scale", "capture-bridge=1"});
  EXPECT_TRUE(until([&] { return rounds_->writers.back() == kFirst; }));
  EXPECT_TRUE(all_sample({kFirst}));
  EXPECT_EQ(rounds_->by.size(), 1U);
  EXPECT_EQ(rounds_->twice, 0);
}

}  // namespace
}  // namespace splatbus::cli
