// A whole pipeline, from the engine to a viewer that means well, under several attacks at once: what it loses by them.
//
// Attackers are paced: each takes little processor time, and the broker and the streamer little for what it sends. What
// is left of that on two cores is no harm, nor is what else runs there. A trainer that takes fewer steps is therefore
// judged by those for the time in which it did not wait for a processor, as the kernel counts it: one that stands still
// waits for none.
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <thread>
#include <vector>

#include "../chaos/pipeline_under_fire.h"
#include "../integration/pipeline.h"
#include "budgets.h"
#include "bus/clock.h"
#include "bus/subscriber.h"
#include "pipeline_attacks.h"

namespace splatbus::hostile {
namespace {

using namespace std::chrono_literals;

constexpr double kSsim = 0.8, kSsimLost = 0.05, kStepsKept = 0.8, kLongestGapS = 3;
/// What the broker keeps for a reader over tcp that takes nothing, until it closes it.
constexpr double kHeldS = 3.5;
constexpr std::size_t kGrowth = 64 * kMiB, kLogBytes = kMiB;

std::chrono::milliseconds attack_time() {
  const char* const seconds = std::getenv("SPLATBUS_HOSTILE_SECONDS");
  return std::chrono::milliseconds(static_cast<int>(1000 * (seconds == nullptr ? 6 : std::strtod(seconds, nullptr))));
}

/// The pipeline of the integration tests, with the doors open that attackers come by.
std::string launch_file(const Ports& ports) {
  std::string text = cli::Pipeline::launch_file();
  const auto replace = [&](const std::string& entry, const std::string& with) {
    const auto at = text.find(entry);
    if (at == std::string::npos) throw std::logic_error("the launch file has no " + entry);
    text.replace(at, entry.size(), with);
  };
  replace("  - name: bus\n", "  - name: bus\n    args: [--tcp, \"127.0.0.1:" + std::to_string(ports.bus) + "\"]\n");
  replace("  - name: streamer\n", "  - name: streamer\n    parameters: {tcp: \"" + ports.stream() + "\"}\n");
  return text;
}

/// Somebody elsewhere who means well, and reads all that there is.
class FarReader {
 public:
  explicit FarReader(int port)
      : thread_([this, port](const std::stop_token& stop) {
          const auto address = bus::Address::parse("tcp://127.0.0.1:" + std::to_string(port));
          bus::Subscriber all(bus::Context::create(address, "far-reader"), {"*"});
          std::int64_t heard_ns = bus::now_ns();
          while (!stop.stop_requested()) {
            const auto message = all.receive(20ms);
            if (message && message->topic() == topics::kModelPublished.name) {
              heard_ns = bus::now_ns();
              model_bytes_ += message->size() + payload_bytes(*message);
            }
            longest_ns_ = std::max(longest_ns_.load(), bus::now_ns() - heard_ns);
          }
        }) {}
  /// All that models had, so far.
  [[nodiscard]] std::size_t model_bytes() const { return model_bytes_; }
  /// Without a model, since the last time that this was asked.
  [[nodiscard]] double take_longest_gap_s() { return static_cast<double>(longest_ns_.exchange(0)) * 1e-9; }

 private:
  static std::size_t payload_bytes(const bus::Message& message) {
    std::size_t bytes = 0;
    for (const auto* tensor : *message.header().tensors()) bytes += tensor->span()->bytes();
    return bytes;
  }
  std::atomic<std::int64_t> longest_ns_ = 0;
  std::atomic<std::size_t> model_bytes_ = 0;
  std::jthread thread_;
};

/// Of a process's threads, since they began: on a processor, and waiting for one.
struct Scheduled {
  double ran_s = 0, waited_s = 0;

  static Scheduled of(pid_t pid) {
    Scheduled sum;
    std::error_code gone;
    for (const auto& thread : std::filesystem::directory_iterator("/proc/" + std::to_string(pid) + "/task", gone)) {
      std::ifstream file(thread.path() / "schedstat");
      double ran_ns = 0, waited_ns = 0;
      file >> ran_ns >> waited_ns;
      sum.ran_s += ran_ns * 1e-9;
      sum.waited_s += waited_ns * 1e-9;
    }
    return sum;
  }
  /// Of the time in which it would have run: all of it on a machine to itself.
  [[nodiscard]] double share_since(const Scheduled& before) const {
    const double ran = ran_s - before.ran_s, waited = waited_s - before.waited_s;
    return ran + waited > 0 ? ran / (ran + waited) : 1;
  }
};

class HostileWhole : public testing::Test {
 protected:
  void SetUp() override {
    pipeline_.sample_pictures();
    ASSERT_TRUE(pipeline_.wait_until_well(kSsim, {})) << pipeline_.log();
    ASSERT_TRUE(pipeline_.wait_until([&] { return pipeline_.state().trainer.gaussians > 4000; })) << pipeline_.log();
  }

  /// What the pipeline does within a time.
  struct Seen {
    double steps_per_s = 0, share = 0, longest_gap_s = 0, least_ssim = 1, mean_ssim = 0;
    double longest_gap_far_s = 0, model_bytes_per_s = 0;
    std::size_t pictures = 0;
    [[nodiscard]] double steps_at_rest_per_s() const { return steps_per_s / share; }
  };
  Seen watch(std::chrono::milliseconds time) {
    const std::size_t first = pipeline_.samples().size();
    const std::uint64_t step = pipeline_.state().trainer.step;
    (void)far_.take_longest_gap_s();
    const std::size_t model_bytes = far_.model_bytes();
    const pid_t trainer = pipeline_.pids().at("trainer");
    const Scheduled scheduled = Scheduled::of(trainer);
    const std::int64_t begin = bus::now_ns();
    pipeline_.let_pass(time);
    const std::int64_t end = bus::now_ns();
    const double seconds = static_cast<double>(end - begin) * 1e-9;
    Seen seen;
    seen.longest_gap_far_s = far_.take_longest_gap_s();
    seen.share = Scheduled::of(trainer).share_since(scheduled);
    seen.model_bytes_per_s = static_cast<double>(far_.model_bytes() - model_bytes) / seconds;
    seen.steps_per_s = static_cast<double>(pipeline_.state().trainer.step - step) / seconds;
    std::int64_t before = begin;
    const auto take_gap = [&](std::int64_t now) {
      seen.longest_gap_s = std::max(seen.longest_gap_s, static_cast<double>(now - before) * 1e-9);
      before = now;
    };
    for (std::size_t k = first; k < pipeline_.samples().size(); ++k) {
      const auto& sample = pipeline_.samples()[k];
      take_gap(sample.time_ns);
      seen.least_ssim = std::min(seen.least_ssim, sample.ssim);
      seen.mean_ssim += sample.ssim;
      ++seen.pictures;
    }
    take_gap(end);
    seen.mean_ssim /= static_cast<double>(std::max<std::size_t>(1, seen.pictures));
    return seen;
  }
  static void say(const char* when, const Seen& seen) {
    std::printf(
        "%s: %.1f steps/s with %.0f %% of a processor, %zu pictures, longest gap %.2f s, SSIM %.3f, least %.3f; "
        "models of %.1f MiB/s, %.2f s without one\n",
        when, seen.steps_per_s, 100 * seen.share, seen.pictures, seen.longest_gap_s, seen.mean_ssim, seen.least_ssim,
        seen.model_bytes_per_s / kMiB, seen.longest_gap_far_s);
  }

  const Ports ports_;
  chaos::PipelineUnderFire pipeline_{launch_file(ports_)};
  // From the start: for who reads over tcp the broker maps what others share.
  FarReader far_{ports_.bus};
};

TEST_F(HostileWhole, GoesOnUnderSeveralAttacksAtOnce) {
  const Seen before = watch(6s);
  say("before", before);
  const auto pids = pipeline_.pids();
  const chaos::Usage usage = pipeline_.usage();
  const std::uint64_t pages = pipeline_.state().page_bytes;
  const std::size_t log_bytes = pipeline_.log_bytes();

  Seen under;
  {
    const auto attacks = all_attacks(ports_);
    under = watch(attack_time());
    for (const auto& attack : attacks) EXPECT_GT(attack->done(), 5) << attack->name() << ": it never got there";
    // While they are at it: what they hold is given back when they go.
    const std::size_t grown = pipeline_.state().page_bytes - std::min(pages, pipeline_.state().page_bytes);
    for (const auto& [name, bytes] : pipeline_.usage().resident_bytes) {
      std::printf("  %s: %zu MiB, %+zd MiB\n", name.c_str(), bytes / kMiB,
                  (static_cast<std::ptrdiff_t>(bytes) - static_cast<std::ptrdiff_t>(usage.resident_bytes.at(name))) /
                      static_cast<std::ptrdiff_t>(kMiB));
      const std::size_t held = name == "bus" ? static_cast<std::size_t>(kHeldS * under.model_bytes_per_s) : 0;
      EXPECT_LT(bytes, usage.resident_bytes.at(name) + kGrowth + grown + held) << name;
    }
  }
  say("under attack", under);
  const Seen after = watch(6s);
  say("after", after);

  EXPECT_EQ(pipeline_.pids(), pids) << "nobody ended\n" << pipeline_.log();
  EXPECT_LT(pipeline_.log_bytes(), log_bytes + kLogBytes);
  EXPECT_LT(under.longest_gap_s, std::max(kLongestGapS, 2 * before.longest_gap_s));
  EXPECT_LT(under.longest_gap_far_s, 3 * kLongestGapS) << "whoever reads over tcp is told of the model";
  EXPECT_GT(under.mean_ssim, before.mean_ssim - kSsimLost);
  EXPECT_GT(under.least_ssim, before.least_ssim - 2 * kSsimLost);
  // A model that is trained changes what a step costs: it is compared with what came before and after.
  const double kept = 2 * under.steps_per_s / (before.steps_per_s + after.steps_per_s);
  const double kept_at_rest =
      2 * under.steps_at_rest_per_s() / (before.steps_at_rest_per_s() + after.steps_at_rest_per_s());
  EXPECT_GT(std::max(kept, kept_at_rest), kStepsKept) << kept << " of its steps";
}

}  // namespace
}  // namespace splatbus::hostile
