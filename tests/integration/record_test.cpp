#include <fmt/format.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <future>
#include <iterator>

#include "command.h"
#include "launch_plan.h"
#include "metrics/metrics.h"
#include "pipeline.h"
#include "scene_view.h"

namespace splatbus::cli {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
constexpr std::chrono::seconds kPatience(90);

// The recorder is there before the engine's first picture.
constexpr const char* kEngine = R"(
services:
  - name: bus
  - name: record
    program: splatbus
    args: [record, --exclude, engine/frame, --output, {}]
  - name: engine
    program: splatbus-engine-sim
    args: [--fps, "10"]
    after: [record]
  - name: capture-bridge
    after: [record]
    parameters: {{input_cameras: 8, input_size: 64, sample_budget: 4000, reference_rig: ring, reference_cameras: 4,
                 reference_size: 64, reference_rate_hz: 2, light_depth_size: 128}}
)";
constexpr const char* kChain = R"(
  - name: expander
  - name: trainer
    parameters: {threads: 1, max_gaussians: 8192}
  - name: relight
)";

bool eventually(const std::function<bool()>& condition) {
  const auto end = std::chrono::steady_clock::now() + kPatience;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
  }
  return true;
}

/// The services of a launch file on a bus of their own.
struct Launched {
  explicit Launched(const std::string& services)
      : context(bus::Context::create(folder.address(), "record-test")),
        run(plan_launch(parse_launch_file(services, "record.yaml"), folder.address(), SPLATBUS_BIN_DIR),
            folder.path() / "services.log") {}

  PrivateBusFolder folder;
  std::shared_ptr<bus::Context> context;
  SupervisedRun run;
};

/// Records until the engine has given a held-out picture and enough to learn from; returns that picture.
ProbePicture record(const fs::path& path) {
  Launched engine(fmt::format(kEngine, path.string()));
  ProbeRounds probes(engine.context, circle_cameras({.count = 1, .size = 64, .phase_degrees = 45}));
  bus::Subscriber references(engine.context, {"capture/reference", "capture/input"});
  std::size_t pictures = 0, rounds = 0;
  std::int64_t asked_ns = 0;
  EXPECT_TRUE(eventually([&] {
    if (bus::now_ns() - asked_ns > 1'500'000'000) {
      probes.begin();
      asked_ns = bus::now_ns();
    }
    probes.poll(std::chrono::milliseconds(20), [](std::size_t, const ProbePicture&) {});
    while (const auto message = references.receive(std::chrono::milliseconds(0))) {
      ++(message->topic() == "capture/input" ? rounds : pictures);
    }
    return probes.complete() && pictures >= 16 && rounds >= 1;
  }));
  engine.run.stop();
  return probes.pictures().empty() ? ProbePicture() : probes.pictures().at(0);
}

TEST(Record, ATrainerLearnsFromARecordingWithoutAnEngine) {
  const PrivateBusFolder folder;
  const fs::path path = folder.path() / "engine.mcap";
  const ProbePicture held_out = record(path);
  ASSERT_FALSE(held_out.picture.empty());
  const Answer info = splatbus_command({"record", "info", path.string(), "--json"});
  ASSERT_EQ(info.lines.size(), 1U);
  EXPECT_EQ(info.json()[0]["damage"], "");
  EXPECT_EQ(info.json()[0]["metadata"]["splatbus.drops"], Json::object());

  Launched chain(std::string("services:\n  - name: bus\n") + kChain);
  PipelineWatch watch(chain.context);
  ASSERT_TRUE(eventually([&] {
    watch.poll(std::chrono::milliseconds(20));
    return chain.run.all_running();
  }));
  auto played = std::async(std::launch::async, [&] {
    return splatbus_command(
        {"play", path.string(), "--topics", "capture/*,scene/*", "--json", "--bus", chain.folder.address().text()});
  });
  // From its first words on: how far it has come by then is the machine's.
  const PipelineState& state = watch.state();
  double worst_loss = 0;
  EXPECT_TRUE(eventually([&] {
    watch.poll(std::chrono::milliseconds(20));
    worst_loss = std::max(worst_loss, state.trainer.loss);
    return state.trainer.step >= 300 && state.trainer.gaussians > 1000 && state.trainer.loss < 0.8 * worst_loss &&
           played.wait_for(std::chrono::seconds(0)) == std::future_status::ready;
  })) << "step "
      << state.trainer.step << ", " << state.trainer.gaussians << " Gaussians, loss " << state.trainer.loss << " of "
      << worst_loss;
  const Answer answer = played.get();
  EXPECT_TRUE(answer.status.success()) << testing::PrintToString(answer.lines);

  LiveScene live(chain.context);
  SceneView view(1);
  double ssim = 0;
  EXPECT_TRUE(eventually([&] {
    live.poll(std::chrono::milliseconds(20));
    if (!live.published() || !live.has_scene()) return false;
    if (const auto drawn = view.render(live, held_out.camera, held_out.scene, nullptr)) {
      ssim = metrics::compare(*drawn, held_out.picture).ssim;
    }
    return ssim > 0.8;
  })) << "SSIM "
      << ssim;
}

/// The demo's launch file, with a recorder that is there before the engine.
std::string recorded_demo(const fs::path& recording) {
  std::ifstream file(default_launch_file("demo.yaml"));
  std::string text{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  const std::string engine = "  - name: engine\n";
  const std::size_t at = text.find(engine);
  EXPECT_NE(at, std::string::npos);
  if (at == std::string::npos) return text;
  const std::string recorder = fmt::format(
      "  - name: record\n    program: splatbus\n    args: [record, --exclude, engine/frame, --output, {}]\n\n",
      recording.string());
  return text.replace(at, engine.size(), recorder + engine + "    after: [record]\n");
}

// How far a run comes is the machine's; that its replay comes as far is the pace's.
TEST(Record, AReplayTakesTheRunsStepsAndEndsAsItDid) {
  const PrivateBusFolder folder;
  const fs::path recording = folder.path() / "demo.mcap", launch = folder.path() / "recorded.yaml";
  std::ofstream(launch) << recorded_demo(recording);
  const Answer run = splatbus_command(
      {"demo", "--seconds", "20", "--launch", launch.string(), "--out", (folder.path() / "run").string(), "--json"});
  ASSERT_TRUE(run.status.success()) << testing::PrintToString(run.lines);
  const Json demo = run.json().back();
  const Answer replay =
      splatbus_command({"eval", "replay", recording.string(), "--out", (folder.path() / "replay").string(), "--json"});
  ASSERT_TRUE(replay.status.success()) << testing::PrintToString(replay.lines);
  const Json replayed = replay.json().back();
  EXPECT_GT(replayed["recorded_steps"], 0);
  EXPECT_EQ(replayed["steps"], replayed["recorded_steps"]);
  EXPECT_EQ(replayed["steps_given_up"], 0);
  EXPECT_EQ(replayed["without_maps"], 0);
  EXPECT_NEAR(replayed["gaussians"].get<double>(), demo["gaussians"].get<double>(),
              0.02 * demo["gaussians"].get<double>());
  // 0.003 is for a minute (docs/benchmarks.md): in the first seconds a step more or less is worth more.
  EXPECT_NEAR(replayed["ssim"].get<double>(), demo["ssim_server"].get<double>(), 0.02);
}

}  // namespace
}  // namespace splatbus::cli
