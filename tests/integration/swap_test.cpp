#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <map>
#include <vector>

#include "../unit/cli/swap_host.h"
#include "bus/publisher.h"
#include "model/published_model.h"
#include "pipeline.h"
#include "wire/model_generated.h"
#include "wire/system_generated.h"

namespace splatbus::cli {
namespace {

/// What the newest model/published of a process says, and whose Gaussians it has.
class ModelWatch {
 public:
  explicit ModelWatch(const std::shared_ptr<bus::Context>& context) : subscriber_(context) {
    subscriber_
        .on(topics::kModelPublished,
            [this](const wire::ModelPublished& published, const bus::Message& message) {
              step = published.step();
              epoch = message.header().epoch();
              counts[epoch] = published.count();
              message_ = message;
            })
        .on(topics::kHeartbeat, [this](const wire::Heartbeat& heartbeat, const bus::Message& message) {
          if (message.header().source()->str() != "trainer") return;
          pid = static_cast<pid_t>(heartbeat.pid());
          for (const auto* counter : *heartbeat.counters()) {
            if (counter->name()->str() == "handed_over") handed_over = counter->value();
          }
        });
  }
  void poll() { subscriber_.dispatch_all(std::chrono::milliseconds(20)); }

  /// Ascending; nothing while the structure changes.
  std::vector<std::uint64_t> ids() {
    const auto model = message_ ? PublishedModel::open(*message_) : std::nullopt;
    std::vector<std::uint64_t> ids;
    if (!model) return ids;
    const GaussiansView& view = model->live();
    for (const IndexRange& range : view.ranges) {
      for (std::uint32_t i = range.first; i < range.first + range.count; ++i) {
        ids.push_back(view.gaussian_id[view.wide_offset(i)]);
      }
    }
    std::sort(ids.begin(), ids.end());
    return ids;
  }

  std::uint64_t step = 0, epoch = 0;
  std::map<std::uint64_t, std::uint64_t> counts;  ///< Gaussians in the last message of each process, by epoch
  pid_t pid = 0;
  double handed_over = 0;

 private:
  bus::Subscriber subscriber_;
  std::optional<bus::Message> message_;
};

double viewer_counter(const Pipeline& pipeline, const std::string& name) {
  const auto counters = pipeline.status("viewer").counters;
  const auto counter = counters.find(name);
  return counter == counters.end() ? 0 : counter->second;
}

void set_paused(const bus::Publisher& publisher, bool paused) {
  publisher.publish(topics::control("control/trainer"), [&](auto& builder, auto header) {
    const std::vector<flatbuffers::Offset<wire::KeyValue>> changes{
        wire::CreateKeyValueDirect(builder, "paused", paused ? "true" : "false")};
    return wire::CreateControlDirect(builder, header, &changes);
  });
}

/// A trainer hands over while nothing else changes the model: its Gaussians, step and moments are the same, and the
/// viewer notices nothing. Then the new one goes on.
TEST(Swap, ATrainerHandsTheModelOver) {
  Pipeline pipeline;
  ModelWatch model(pipeline.context());
  const bus::Publisher publisher(pipeline.context());
  ASSERT_TRUE(pipeline.wait_for_picture(0.8)) << pipeline.log();
  set_paused(publisher, true);
  std::vector<std::uint64_t> before;
  ASSERT_TRUE(pipeline.wait_until([&] {
    model.poll();
    const PipelineState::Trainer& trainer = pipeline.state().trainer;
    if (!trainer.paused || model.step != trainer.step || pipeline.state().grid.batches_pending > 0) return false;
    before = model.ids();
    return !before.empty() && before.size() == trainer.gaussians;
  })) << pipeline.log();
  const std::uint64_t step = model.step, epoch = model.epoch;
  const double lost = viewer_counter(pipeline, "lost_packets");
  const auto pids = pipeline.pids();

  ChildSwapHost host(pids.at("trainer"), std::string(SPLATBUS_BIN_DIR) + "/splatbus-trainer",
                     {"--bus", pipeline.address().text(), "--name", "trainer", "--successor", "--set", "threads=1",
                      "--set", "max_gaussians=8192", "--set", "paused=true"});
  ASSERT_NO_THROW(run_swap(host, pipeline.context(), "trainer", {}, [](const std::string&) {}, {}))
      << pipeline.log() << testing::PrintToString(host.lines);
  ASSERT_TRUE(pipeline.wait_until([&] {
    model.poll();
    return model.epoch > epoch && model.pid == host.successor->pid() && model.handed_over > 0 && !model.ids().empty();
  })) << testing::PrintToString(host.lines);
  // Pictures and rounds go on: some may be carved since, and others inserted.
  const std::vector<std::uint64_t> after = model.ids();
  EXPECT_EQ(std::ranges::adjacent_find(after), after.end()) << "one is there twice";
  EXPECT_EQ(model.step, step);
  EXPECT_EQ(model.handed_over, static_cast<double>(model.counts[epoch]))
      << "none lost, by ids, when it took over: each with its moments and age";

  set_paused(publisher, false);
  EXPECT_TRUE(pipeline.wait_until([&] {
    model.poll();
    return model.step > step;
  })) << testing::PrintToString(host.lines);
  EXPECT_TRUE(pipeline.wait_for_picture(0.8)) << pipeline.log();
  EXPECT_EQ(viewer_counter(pipeline, "lost_packets"), lost) << "the stream goes on without a gap";
  EXPECT_EQ(pipeline.pids().at("viewer"), pids.at("viewer"));
}

TEST(Swap, ATrainerThatIsRestartedGoesOnWithItsMoments) {
  Pipeline pipeline;
  ModelWatch model(pipeline.context());
  ASSERT_TRUE(pipeline.wait_for_picture(0.8)) << pipeline.log();
  ASSERT_TRUE(pipeline.wait_until([&] {
    model.poll();
    return model.pid != 0 && model.epoch != 0;
  })) << pipeline.log();
  const std::uint64_t epoch = model.epoch;
  const pid_t pid = model.pid;
  ASSERT_EQ(model.handed_over, 0);
  ASSERT_EQ(::kill(pid, SIGTERM), 0);
  ASSERT_TRUE(pipeline.wait_until([&] {
    model.poll();
    return model.epoch > epoch && model.pid != pid && model.handed_over > 0;
  })) << pipeline.log();
  EXPECT_EQ(model.handed_over, static_cast<double>(model.counts[epoch])) << "each with its moments and age";
}

}  // namespace
}  // namespace splatbus::cli
