#include "pipeline.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "command.h"
#include "splats/file.h"

namespace splatbus::cli {
namespace {

using Json = nlohmann::json;
using testing::HasSubstr;

/// One pipeline for all commands: they only look.
class RunningPipeline : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    pipeline_ = std::make_unique<Pipeline>();
    ASSERT_TRUE(pipeline_->wait_for_picture(0.8)) << pipeline_->log();
    bus_ = pipeline_->address().text();
  }
  static void TearDownTestSuite() { pipeline_.reset(); }

  static inline std::unique_ptr<Pipeline> pipeline_;
  static inline std::string bus_;
};

TEST_F(RunningPipeline, ReachesTheViewer) {
  const PipelineState& state = pipeline_->state();
  EXPECT_GT(state.first_picture_ns, 0);
  EXPECT_LT(state.first_picture_ns, bus::now_ns());
  ASSERT_TRUE(pipeline_->wait_until([&] { return state.stream.viewers == 1 && state.trainer.step > 0; }))
      << pipeline_->log();
  EXPECT_GT(state.trainer.gaussians, 500U);
  EXPECT_LE(state.trainer.gaussians, 8192U);
  EXPECT_EQ(state.trainer.ready_references, 4U);
  EXPECT_EQ(state.trainer.ready_inputs, 8U);
  EXPECT_GT(state.stream.wire_mbps_peak, 0);
  for (const auto& [name, pid] : pipeline_->pids()) EXPECT_EQ(pipeline_->status(name).restarts, 0) << name;
}

TEST_F(RunningPipeline, TopicListKnowsEveryTopic) {
  const Answer answer = splatbus_command({"topic", "list", "--seconds", "2.5", "--json", "--bus", bus_});
  EXPECT_TRUE(answer.status.success());
  std::map<std::string, Json> topics;
  for (const Json& line : answer.json()) topics[line.at("topic")] = line;
  for (const char* topic : {"engine/cameras", "engine/frame", "capture/reference", "scene/state", "scene/light_depth",
                            "model/published", "trainer/stats", "grid/state", "relight/visibility", "stream/stats",
                            "sys/heartbeat", "sys/liveness", "viewer/pose"}) {
    EXPECT_TRUE(topics.contains(topic)) << topic;
  }
  EXPECT_EQ(topics["engine/frame"]["schemas"], Json::array({"EngineFrame/3"}));
  EXPECT_EQ(topics["engine/frame"]["sources"], Json::array({"engine"}));
  EXPECT_GT(topics["engine/frame"]["rate_hz"], 0.5);
  EXPECT_TRUE(topics["model/published"]["latched"]);
}

TEST_F(RunningPipeline, TopicEchoDecodesEveryTopic) {
  for (const char* topic :
       {"engine/cameras", "engine/frame", "capture/reference", "scene/state", "scene/light_depth", "model/published",
        "trainer/stats", "grid/state", "stream/stats", "sys/heartbeat", "viewer/pose"}) {
    const Answer answer =
        splatbus_command({"topic", "echo", topic, "-n", "1", "--seconds", "30", "--json", "--bus", bus_});
    ASSERT_TRUE(answer.status.success()) << topic;
    ASSERT_EQ(answer.lines.size(), 1U) << topic;
    const Json json = answer.json().front();
    EXPECT_EQ(json.value("topic", ""), topic);
    EXPECT_GT(json["message"]["header"]["sequence"], 0) << topic;
  }
  const Json frame = splatbus_command({"topic", "echo", "capture/reference", "-n", "1", "--json", "--bus", bus_})
                         .json()
                         .front()["message"];
  const Json color = frame["header"]["tensors"][0];
  EXPECT_EQ(color["name"], "color");
  EXPECT_EQ(color["type"], "U8");
  EXPECT_EQ(color["shape"], Json::array({frame["camera"]["height"], frame["camera"]["width"], 4}));
  EXPECT_GT(color["max"], color["min"]);
}

TEST_F(RunningPipeline, TopicRatesAndBandwidth) {
  const Answer hz = splatbus_command({"topic", "hz", "sys/heartbeat", "--seconds", "2.2", "--json", "--bus", bus_});
  EXPECT_TRUE(hz.status.success());
  ASSERT_FALSE(hz.lines.empty());
  EXPECT_GT(hz.json().back()["rate_hz"], 8) << "eight services, a few times a second each";
  const Answer bw = splatbus_command({"topic", "bw", "capture/reference", "--seconds", "2.2", "--json", "--bus", bus_});
  EXPECT_TRUE(bw.status.success());
  ASSERT_FALSE(bw.lines.empty());
  const Json rates = bw.json().back();
  EXPECT_GT(rates["mbps"].get<double>() + rates["shared_mbps"].get<double>(), 0.1)
      << "pictures of 64 x 64 x 8 bytes, at least one a second";
}

TEST_F(RunningPipeline, NodeListShowsEveryService) {
  const Answer answer = splatbus_command({"node", "list", "--json", "--bus", bus_});
  EXPECT_TRUE(answer.status.success());
  std::map<std::string, pid_t> pids;
  for (const Json& node : answer.json()) {
    pids[node.at("source")] = node.at("pid");
    EXPECT_EQ(node.at("state"), "Running") << node;
    EXPECT_THAT(node.at("backend"), testing::AnyOf(node.at("source") == "bus" ? "" : "cpu", "cuda")) << node;
    EXPECT_LT(node.at("age_s"), 5) << node;
  }
  EXPECT_EQ(pids, pipeline_->pids());
}

TEST_F(RunningPipeline, NodeListWaitsForTheServicesOfAFile) {
  const std::string file = *pipeline_->address().directory + "/wait.yaml";
  std::ofstream(file) << Pipeline::launch_file();
  const Answer there = splatbus_command({"node", "list", "--wait", file, "--json", "--bus", bus_});
  EXPECT_TRUE(there.status.success()) << testing::PrintToString(there.lines);
  EXPECT_GE(there.lines.size(), 8U);
  std::ofstream(file, std::ios::app) << "  - {name: viewer-7, program: splatbus-viewer}\n";
  const Answer missing = splatbus_command({"node", "list", "--wait", file, "--timeout", "0.5", "--bus", bus_});
  EXPECT_EQ(missing.status.code, 1);
  EXPECT_THAT(missing.lines, testing::Contains(HasSubstr("not alive within 0.5 s on " + bus_ + ": viewer-7")));
}

TEST_F(RunningPipeline, ExportWritesAModelThatCanBeRead) {
  const std::string path = *pipeline_->address().directory + "/model.ply";
  const Answer answer = splatbus_command({"export", path, "--json", "--bus", bus_});
  ASSERT_TRUE(answer.status.success());
  const GaussiansBuffer model = splats::read_file(path).gaussians;
  EXPECT_EQ(answer.json().front()["gaussians"], model.count());
  EXPECT_GT(model.count(), 500U);
  const Answer bad = splatbus_command({"export", "/nonexistent/model.ply", "--bus", bus_});
  EXPECT_EQ(bad.status.code, 1);
  EXPECT_THAT(bad.lines, testing::Contains(HasSubstr("/nonexistent/model.ply")));
}

TEST(Commands, WithoutABusTheySaySo) {
  const PrivateBusFolder nobody;
  const std::string bus = nobody.address().text();
  const Answer topics = splatbus_command({"topic", "list", "--seconds", "0.2", "--bus", bus});
  EXPECT_EQ(topics.status.code, 1);
  EXPECT_THAT(topics.lines, testing::Contains(HasSubstr("no bus at " + bus)));
  const Answer nodes = splatbus_command({"node", "list", "--seconds", "0.2", "--bus", bus});
  EXPECT_EQ(nodes.status.code, 1);
  EXPECT_THAT(nodes.lines, testing::Contains(HasSubstr("no bus at " + bus)));
  const Answer model = splatbus_command({"export", "/tmp/never.ply", "--timeout", "0.2", "--bus", bus});
  EXPECT_EQ(model.status.code, 1);
  EXPECT_THAT(model.lines, testing::Contains(HasSubstr("no bus at " + bus)));
}

TEST(Commands, HelpAndVersionEverywhere) {
  for (const std::vector<std::string>& verb : std::vector<std::vector<std::string>>{{},
                                                                                    {"launch"},
                                                                                    {"topic"},
                                                                                    {"topic", "list"},
                                                                                    {"topic", "echo"},
                                                                                    {"topic", "hz"},
                                                                                    {"topic", "bw"},
                                                                                    {"node"},
                                                                                    {"node", "list"},
                                                                                    {"export"},
                                                                                    {"eval"},
                                                                                    {"eval", "fixed"},
                                                                                    {"eval", "start"},
                                                                                    {"eval", "dynamics"},
                                                                                    {"eval", "relight"},
                                                                                    {"demo"}}) {
    std::vector<std::string> arguments = verb;
    arguments.emplace_back("--help");
    const Answer answer = splatbus_command(arguments);
    EXPECT_TRUE(answer.status.success());
    EXPECT_THAT(answer.lines, testing::Contains(HasSubstr("Usage:")));
  }
  EXPECT_THAT(splatbus_command({"--version"}).lines,
              testing::ElementsAre(testing::MatchesRegex("splatbus [0-9]+.[0-9]+.[0-9]+")));
  EXPECT_EQ(splatbus_command({"nonsense"}).status.code, 2);
  EXPECT_EQ(splatbus_command({}).status.code, 2);
}

}  // namespace
}  // namespace splatbus::cli
