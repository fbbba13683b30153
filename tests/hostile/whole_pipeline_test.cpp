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
#include <functional>
#include <thread>
#include <vector>

#include "../chaos/pipeline_under_fire.h"
#include "../integration/pipeline.h"
#include "../unit/bus/fake_broker.h"
#include "budgets.h"
#include "bus/clock.h"
#include "raw_zmtp.h"
#include "stream_words.h"
#include "wire/system_generated.h"

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

struct Ports {
  int bus = 20000 + ::getpid() % 10000 * 3;
  [[nodiscard]] std::string writers() const { return "tcp://127.0.0.1:" + std::to_string(bus); }
  [[nodiscard]] std::string readers() const { return "tcp://127.0.0.1:" + std::to_string(bus + 1); }
  [[nodiscard]] std::string stream() const { return "tcp://127.0.0.1:" + std::to_string(bus + 2); }
};

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

/// One thing done again and again on a thread of its own, `per_s` times a second. What goes wrong with it is what was
/// wanted.
class Attack {
 public:
  Attack(std::string name, double per_s, std::function<void()> once)
      : name_(std::move(name)), thread_([this, per_s, once = std::move(once)](const std::stop_token& stop) {
          const auto period =
              std::chrono::duration_cast<std::chrono::steady_clock::duration>(std::chrono::duration<double>(1 / per_s));
          for (auto next = std::chrono::steady_clock::now(); !stop.stop_requested(); next += period) {
            std::this_thread::sleep_until(next);
            try {
              once();
              ++done_;
            } catch (const std::exception&) {
              std::this_thread::sleep_for(100ms);  // nobody lets it in just now
            }
          }
        }) {}
  [[nodiscard]] const std::string& name() const { return name_; }
  [[nodiscard]] int done() const { return done_; }

 private:
  const std::string name_;
  std::atomic<int> done_ = 0;
  std::jthread thread_;
};

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

/// A connection that is made again when it was closed.
class Connection {
 public:
  Connection(std::string endpoint, std::string type, std::string first = "")
      : endpoint_(std::move(endpoint)), type_(std::move(type)), first_(std::move(first)) {}

  void send(const std::string& bytes, bool more = false) {
    if (!raw_) open();
    if (!raw_->send_frame(bytes, more)) raw_.reset();
  }
  /// Reads some, and no more than that.
  void read(std::size_t bytes) {
    if (!raw_) open();
    if (raw_->read_some(bytes, 1ms).empty() && raw_->closed_within(1ms)) raw_.reset();
  }

 private:
  void open() {
    RawZmtp raw(endpoint_);
    if (!raw.handshake(type_) || (!first_.empty() && !raw.send_frame(first_, false)))
      throw std::runtime_error("closed");
    raw_.emplace(std::move(raw));
  }
  const std::string endpoint_, type_, first_;
  std::optional<RawZmtp> raw_;
};

std::string heartbeat(const std::string& source, std::size_t service_bytes) {
  flatbuffers::FlatBufferBuilder builder;
  builder.ForceDefaults(true);
  const auto header = wire::CreateHeaderDirect(builder, std::string(topics::kHeartbeat.schema).c_str(), source.c_str(),
                                               ~0ULL, ~0ULL, 0, INT64_MAX, 0, true, source.c_str());
  builder.Finish(wire::CreateHeartbeatDirect(builder, header, std::string(service_bytes, 'x').c_str(), 1,
                                             wire::ServiceState::Stopping));
  return {reinterpret_cast<const char*>(builder.GetBufferPointer()), builder.GetSize()};
}

std::vector<std::unique_ptr<Attack>> all_attacks(const Ports& ports) {
  std::vector<std::unique_ptr<Attack>> attacks;
  const auto add = [&](const std::string& name, double per_s, std::function<void()> once) {
    attacks.push_back(std::make_unique<Attack>(name, per_s, std::move(once)));
  };
  // Where the viewer's own path leads past, so that nobody is asked to model another place.
  const Camera beside = look_at({2.4F, 1.6F, 2.4F}, {0, 0.25F, 0}, 64, 64, 1);
  const auto viewer = [&](const std::string& name, double per_s, std::vector<std::string> words) {
    const auto connection = std::make_shared<Connection>(ports.stream(), "DEALER", hello());
    add(name, per_s, [connection, words = std::move(words), k = std::size_t{0}]() mutable {
      connection->send(words[k++ % words.size()]);
    });
  };
  viewer("poses", 500, {pose(beside)});
  viewer("hellos and byes", 100, {hello(), bye()});
  viewer("garbage", 200, {pose(Camera()), std::string(200, '\xff')});
  std::vector<std::string> probes;
  for (std::uint64_t id = 1; id <= 64; ++id) probes.push_back(probe((1ULL << 40) + id, beside));
  viewer("probes", 50, probes);

  const auto writer = std::make_shared<std::optional<bus_test::RawPublisher>>();
  add("forgeries", 50, [writer, ports, k = 0]() mutable {
    if (!*writer) writer->emplace(ports.writers());
    const char* const names[] = {"streamer", "trainer", "engine", "bus", "viewer"};
    ++k;
    (*writer)->send({"sys/heartbeat", heartbeat(names[k % 5], 7)});
    (*writer)->send({"sys/heartbeat", heartbeat("stranger" + std::to_string(k), k % 10 == 0 ? kMiB : 7)});
    (*writer)->send({"engine/frame", std::string(500, '\xff')});
  });
  const std::string part(30000, 'x');
  for (const auto& [endpoint, type] : {std::pair(ports.stream(), "DEALER"), std::pair(ports.writers(), "XPUB")}) {
    const auto endless = std::make_shared<Connection>(endpoint, type);
    add("a message without an end to " + endpoint, 20, [endless, part] { endless->send(part, true); });
  }
  const auto deaf = std::make_shared<Connection>(ports.readers(), "SUB", "\x01model/");
  add("a deaf reader", 10, [deaf] { deaf->send("\x01model/"); });
  const auto trickler = std::make_shared<Connection>(ports.readers(), "SUB", "\x01engine/");
  add("a reader that trickles", 10, [trickler] { trickler->read(8000); });
  const auto subscriber = std::make_shared<Connection>(ports.readers(), "SUB");
  add("subscriptions", 100, [subscriber, k = 0]() mutable { subscriber->send("\x01" + std::to_string(++k)); });
  for (const std::string& endpoint : {ports.stream(), ports.writers(), ports.readers()}) {
    add("connections to " + endpoint, 20, [endpoint] { RawZmtp raw(endpoint); });
  }
  return attacks;
}

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
