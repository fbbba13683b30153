// Engines that share the cameras of one world, and bridges of which one writes.
#include <gtest/gtest.h>

#include <algorithm>
#include <csignal>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <tuple>

#include "pipeline.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"
#include "wire/engine_generated.h"

namespace splatbus::cli {
namespace {

constexpr double kSsim = 0.7;  // of a scene that moves, small

std::string launch_file() {
  std::string text = Pipeline::launch_file();
  const auto replace = [&](const std::string& from, const std::string& to) {
    text.replace(text.find(from), from.size(), to);
  };
  replace("args: [--fps, \"10\"]",
          "args: [--fps, \"10\", --shared-clock, --dynamics, --sun-rate, \"6\"]\n    replicas: 2");
  replace("- name: capture-bridge", "- name: capture-bridge\n    replicas: 2");
  return text;
}

/// But for rounding: what is handed on has been made unit once more. In a frame's time the sun turns by 0.01.
bool same(const SceneState& a, const SceneState& b) {
  constexpr float kRounding = 1e-5F;
  const auto stands = [](const auto& object, const auto& other) {
    const Rigid &p = object.second.rigid, &q = other.second.rigid;
    return object.first == other.first && glm::distance(p.translation, q.translation) < kRounding &&
           glm::length(p.rotation - q.rotation) < kRounding;
  };
  return glm::distance(a.light.sun_direction, b.light.sun_direction) < kRounding &&
         std::ranges::equal(a.objects, b.objects, stands);
}

/// Compares what is handed on with what the engine has said of the very frame, by itself.
class Pictures {
 public:
  explicit Pictures(const std::shared_ptr<bus::Context>& context)
      : subscriber_(context, {"engine/frame", "capture/reference", "engine/cameras", "scene/state"}) {}

  void poll() {
    while (auto message = subscriber_.receive(std::chrono::milliseconds(0))) {
      const std::string source = message->header().source()->str();
      if (message->topic() == "engine/frame") {
        const auto& frame = message->root<wire::EngineFrame>();
        shown_[{source, message->header().capture_ns()}] = from_wire(*frame.scene());
        while (shown_.size() > kMostFrames) shown_.erase(shown_.begin());
        cameras_[{frame.camera()->role(), frame.camera()->id(), message->header().capture_ns()}] = source;
        continue;
      }
      if (writers.empty() || writers.back() != source) writers.push_back(source);
      if (message->topic() == "capture/reference") take(message->root<wire::CaptureReference>());
    }
  }

  std::vector<std::string> writers;      ///< in their order
  std::map<std::string, int> of_engine;  ///< pictures
  std::uint64_t newest_version = 0;
  int wrong = 0;

 private:
  static constexpr std::size_t kMostFrames = 20000;

  void take(const wire::CaptureReference& reference) {
    if (reference.retire()) return;
    const wire::Camera& camera = *reference.camera();
    const std::int64_t capture_ns = reference.header()->capture_ns();
    const auto source = cameras_.find({camera.role(), camera.id(), capture_ns});
    if (source == cameras_.end()) return;  // of before this began to read
    ++of_engine[source->second];
    const SceneState said = from_wire(*reference.scene());
    newest_version = std::max(newest_version, said.version);
    SceneState shown = shown_.at({source->second, capture_ns});
    shown.objects[kFarFieldFrame] = far_field();
    wrong += same(shown, said) ? 0 : 1;
    // All pictures of one version show the same.
    const auto [first, is_new] = of_version_.try_emplace(said.version, said);
    wrong += first->second.objects == said.objects && first->second.light == said.light ? 0 : 1;
  }

  bus::Subscriber subscriber_;
  std::map<std::pair<std::string, std::int64_t>, SceneState> shown_;  // by engine and capture_ns
  std::map<std::tuple<wire::CameraRole, std::uint32_t, std::int64_t>, std::string> cameras_;
  std::map<std::uint64_t, SceneState> of_version_;
};

double counter(const Pipeline& pipeline, const std::string& process, const std::string& name) {
  const auto counters = pipeline.status(process).counters;
  const auto found = counters.find(name);
  return found == counters.end() ? -1 : found->second;
}

TEST(Engines, TwoMakeOneModelAndAnyProcessMayDie) {
  Pipeline pipeline(launch_file());
  Pictures pictures(pipeline.context());
  const auto until = [&](const std::function<bool()>& condition) {
    return pipeline.wait_until([&] {
      pictures.poll();
      return condition();
    });
  };
  const auto both_bring = [&](int count) {
    pictures.of_engine.clear();
    return until([&] { return pictures.of_engine["engine-1"] >= count && pictures.of_engine["engine-2"] >= count; });
  };
  ASSERT_TRUE(both_bring(20)) << pipeline.log();
  ASSERT_TRUE(pipeline.wait_for_picture(kSsim)) << pipeline.log();
  ASSERT_TRUE(both_bring(20)) << pipeline.log();
  EXPECT_EQ(pictures.writers.size(), 1U) << pipeline.log();
  const double cameras = counter(pipeline, "engine-1", "cameras") + counter(pipeline, "engine-2", "cameras");
  EXPECT_EQ(cameras, counter(pipeline, pictures.writers.back(), "cameras"));

  // The bridge that leads dies: the other goes on, and leads for good.
  const std::string first = pictures.writers.back();
  const std::string second = first == "capture-bridge-1" ? "capture-bridge-2" : "capture-bridge-1";
  const std::uint64_t before = pictures.newest_version;
  ASSERT_EQ(kill(pipeline.pids().at(first), SIGKILL), 0);
  ASSERT_TRUE(until([&] { return pictures.writers.back() == second; })) << pipeline.log();
  pictures.newest_version = 0;
  ASSERT_TRUE(both_bring(20)) << pipeline.log();
  EXPECT_GT(pictures.newest_version, before);
  ASSERT_TRUE(until(
      [&] { return pipeline.status(first).restarts == 1 && pipeline.status(first).state == ProcessState::Running; }));
  ASSERT_TRUE(both_bring(10)) << pipeline.log();
  EXPECT_EQ(pictures.writers, (std::vector<std::string>{first, second}));

  // Either engine falls silent, the one that leads and one that follows: all cameras are the other's until it is back.
  for (const std::string silent : {"engine-1", "engine-2"}) {
    const std::string other = silent == "engine-1" ? "engine-2" : "engine-1";
    SCOPED_TRACE(silent);
    const pid_t pid = pipeline.pids().at(silent);
    ASSERT_EQ(kill(pid, SIGSTOP), 0);
    EXPECT_TRUE(until([&] { return counter(pipeline, other, "cameras") == cameras; })) << pipeline.log();
    pictures.of_engine.clear();
    EXPECT_TRUE(until([&] { return pictures.of_engine[other] >= 20; })) << pipeline.log();
    kill(pid, SIGCONT);  // unless the supervisor has started it again
    ASSERT_TRUE(both_bring(20)) << pipeline.log();
  }
  EXPECT_TRUE(pipeline.wait_for_picture(kSsim)) << pipeline.log();
  EXPECT_EQ(pictures.wrong, 0);
}

}  // namespace
}  // namespace splatbus::cli
