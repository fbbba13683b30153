#include "pipeline_attacks.h"

#include <chrono>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <utility>

#include "../unit/bus/fake_broker.h"
#include "budgets.h"
#include "raw_zmtp.h"
#include "stream_words.h"
#include "wire/system_generated.h"
#include "wire/topics.h"

namespace splatbus::hostile {

using namespace std::chrono_literals;

Attack::Attack(std::string name, double per_s, std::function<void()> once)
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

namespace {

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

}  // namespace

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

}  // namespace splatbus::hostile
