// What the bus costs: small messages between two processes through the broker, against ZeroMQ alone with and without a
// proxy; and a large payload by slab, against ZeroMQ's copy. Every process is one of its own, as in a pipeline.
#include <fmt/format.h>
#include <time.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstring>
#include <fstream>
#include <functional>
#include <map>
#include <string>
#include <thread>
#include <vector>

#include "bench/bus_ways.h"
#include "bench/processes.h"
#include "bus/publisher.h"
#include "bus/subscriber.h"
#include "wire/system_generated.h"

namespace splatbus::bench {

namespace {

struct Options {
  double seconds = 2, paced_hz = 1000, offered_hz = 300e3;
  int runs = 3;
  bool small_only = false, bus_only = false;
  std::size_t megabytes = 64;
};

constexpr std::size_t kWindow = 2048;  // on the way at most, below the high-water mark of 4096
constexpr Topic<wire::Log> kLarge{"bench/large"};

enum class Pace { Flood, Offered, Single };

/// Sends until the time is over: as many as the window lets through, at a rate in bursts, or one at a time.
void send_for(const Options& options, Pace pace, Shared& shared, const std::function<void()>& send) {
  const std::int64_t begin = bus::now_ns(), end = begin + static_cast<std::int64_t>(options.seconds * 1e9);
  const double rate = pace == Pace::Single ? options.paced_hz : options.offered_hz;
  std::uint64_t sent = 0;
  for (std::int64_t now = begin; now < end; now = bus::now_ns()) {
    const bool room = sent - shared.received.load(std::memory_order_acquire) < kWindow;
    const bool due = pace == Pace::Flood || static_cast<double>(sent) < static_cast<double>(now - begin) * 1e-9 * rate;
    if (room && due) {
      send();
      ++sent;
    } else if (pace == Pace::Single) {
      std::this_thread::sleep_for(std::chrono::microseconds(100));
    } else {
      std::this_thread::sleep_for(std::chrono::microseconds(20));
    }
  }
  shared.sent = sent;
}

/// Processor time of a process and all its threads, which other programs of the machine hardly change.
double processor_us(pid_t pid) {
  clockid_t clock = 0;
  timespec time{};
  if (::clock_getcpuclockid(pid, &clock) != 0 || ::clock_gettime(clock, &time) != 0) return 0;
  return static_cast<double>(time.tv_sec) * 1e6 + static_cast<double>(time.tv_nsec) * 1e-3;
}

struct Result {
  double rate_hz = 0, median_us = 0, p99_us = 0;
  std::vector<double> processor_us;  ///< a message: of the relay where there is one, the reader, the sender
  std::uint64_t lost = 0;
};

Result measure(const Options& options, const Way& way, Pace pace) {
  const Folder folder;
  const SharedMemory<Shared> shared;
  std::vector<Process> processes;
  if (way.relay) processes.emplace_back([&] { way.relay(folder.path()); });
  processes.emplace_back([&] { way.read(folder.path(), *shared); });
  // Whoever publishes sees the subscription; the broker's subscriber has been acknowledged.
  if (way.name == kOurs) wait_for([&] { return shared->reads.load(); });
  processes.emplace_back([&] {
    const auto send = way.make_sender(folder.path());
    send_for(options, pace, *shared, send);
    while (true) ::pause();
  });
  wait_for([&] { return shared->sent.load() > 0; });
  // What is still on the way arrives, or is lost.
  for (std::uint64_t before = 0; shared->received < shared->sent && shared->received != before;) {
    before = shared->received;
    std::this_thread::sleep_for(std::chrono::milliseconds(200));
  }
  Result result;
  const std::uint64_t received = shared->received;
  for (const Process& process : processes) {
    result.processor_us.push_back(processor_us(process.pid()) / static_cast<double>(shared->sent));
  }
  result.lost = shared->sent - received;
  result.rate_hz = static_cast<double>(received) / (static_cast<double>(shared->last_ns - shared->first_ns) * 1e-9);
  std::vector<std::int32_t> samples(
      shared->latency_ns.begin(),
      shared->latency_ns.begin() + static_cast<long>(std::min<std::uint64_t>(received, kSamples)));
  std::sort(samples.begin(), samples.end());
  if (samples.empty()) return result;
  result.median_us = samples[samples.size() / 2] * 1e-3;
  result.p99_us = samples[samples.size() * 99 / 100] * 1e-3;
  return result;
}

/// The best of several runs that alternate, since other programs of the machine only ever slow them down.
void small_messages(const Options& options) {
  const std::pair<Pace, std::string> paces[] = {
      {Pace::Flood, "as many as go"},
      {Pace::Offered, fmt::format("{:.0f} offered a second", options.offered_hz)},
      {Pace::Single, fmt::format("one at a time, {:.0f} a second", options.paced_hz)}};
  for (const auto& [pace, title] : paces) {
    std::map<std::string, Result> best;
    for (int run = 0; run < options.runs; ++run) {
      for (const Way& way : ways()) {
        if (options.bus_only && way.name != kOurs) continue;
        const Result result = measure(options, way, pace);
        const auto [found, fresh] = best.try_emplace(way.name, result);
        Result& kept = found->second;
        const bool better = pace == Pace::Flood ? result.rate_hz > kept.rate_hz : result.median_us < kept.median_us;
        if (!fresh && better) kept = result;
      }
    }
    fmt::print("small messages, {} (CPU: relay, reader, sender)\n", title);
    for (const Way& way : ways()) {
      if (!best.contains(way.name)) continue;
      const Result& r = best.at(way.name);
      std::string processor;
      for (const double us : r.processor_us) processor += fmt::format(" {:.2f}", us);
      fmt::print("  {:<18} {:>9.0f} /s  median {:>8.1f} us  p99 {:>9.1f} us  lost {:>6}  CPU us a message:{}\n",
                 way.name, r.rate_hz, r.median_us, r.p99_us, r.lost, processor);
    }
    if (options.bus_only) continue;
    const Result &ours = best.at(kOurs), &proxy = best.at("ZeroMQ, proxy");
    fmt::print("  of the proxy: {:.2f} of its rate, {:.2f} of its median\n", ours.rate_hz / proxy.rate_hz,
               ours.median_us / proxy.median_us);
  }
}

/// KiB of this process that are its own and no file's or slab's.
std::uint64_t anonymous_kib() {
  std::ifstream status("/proc/self/status");
  std::string word;
  for (std::uint64_t kib = 0; status >> word;) {
    if (word == "RssAnon:" && status >> kib) return kib;
  }
  return 0;
}

struct LargeShared {
  Shared messages;
  std::atomic<std::uint64_t> grown_kib;
};

constexpr int kLargeMessages = 20;

/// From publish to a reader that has looked at both ends of the payload.
void large_by_slab(const Options& options, const std::string& folder, LargeShared& shared) {
  const std::size_t bytes = options.megabytes << 20;
  const std::vector<std::uint32_t> shape{static_cast<std::uint32_t>(bytes)};
  Process broker([&] { bus_relay(folder); });
  Process reader([&] {
    bus::Subscriber subscriber(bus::Context::create(bus::Address::parse("ipc://" + folder), "reader"));
    std::uint64_t before_kib = 0;
    subscriber.on(kLarge, [&](const wire::Log&, const bus::Message& message) {
      auto payload = message.tensor("payload");
      // The first time a slab is asked for, the registry's connection may not be there yet.
      for (int turn = 0; !payload && turn < 1000; ++turn) {
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
        payload = message.tensor("payload");
      }
      if (!payload) throw std::runtime_error("the payload is gone");
      const auto* data = static_cast<const volatile std::byte*>(payload->data());
      if (data[0] != data[bytes - 1] || !payload->still_valid()) throw std::runtime_error("the payload is another's");
      shared.messages.take(message.header().publish_ns());
      if (before_kib == 0) before_kib = anonymous_kib();
      shared.grown_kib = anonymous_kib() - std::min(anonymous_kib(), before_kib);
    });
    if (!subscriber.wait_connected(std::chrono::seconds(20))) throw std::runtime_error("no broker");
    shared.messages.reads = true;
    while (true) subscriber.dispatch_all(kPatience);
  });
  wait_for([&] { return shared.messages.reads.load(); });
  Process sender([&] {
    const auto context = bus::Context::create(bus::Address::parse("ipc://" + folder), "sender");
    const bus::Publisher publisher(context);
    const auto slab = context->create_slab("payload", 2, bytes);
    for (std::uint64_t i = 0; i < kLargeMessages; ++i) {
      const std::size_t slot = slab->next_slot();
      std::memset(slab->slot_data(slot), static_cast<int>(i), bytes);
      const auto generation = slab->end_write(slot);
      const bus::MessageInfo info{.tensors = {{.name = "payload",
                                               .shape = shape,
                                               .type = bus::ElementType::U8,
                                               .span = slab->span(slot, 0, bytes, generation)}}};
      publisher.publish(kLarge, info, [](auto& builder, auto header) {
        return wire::CreateLogDirect(builder, header, wire::LogLevel::Info, "large");
      });
      wait_for([&] { return shared.messages.received == i + 1; });
    }
    while (true) ::pause();
  });
  wait_for([&] { return shared.messages.received == kLargeMessages; });
}

void large_by_zmq(const Options& options, const std::string& folder, LargeShared& shared) {
  Process reader([&] { zmq_read(folder, shared.messages); });
  Process sender([&] {
    const auto send = zmq_sender(folder, false, options.megabytes << 20);
    for (std::uint64_t i = 0; i < kLargeMessages; ++i) {
      send();
      wait_for([&] { return shared.messages.received == i + 1; });
    }
    while (true) ::pause();
  });
  wait_for([&] { return shared.messages.received == kLargeMessages; });
}

double median_us(const Shared& shared) {
  std::vector<std::int32_t> samples(shared.latency_ns.begin() + 1, shared.latency_ns.begin() + kLargeMessages);
  std::sort(samples.begin(), samples.end());
  return samples[samples.size() / 2] * 1e-3;
}

void large_payloads(const Options& options) {
  const SharedMemory<LargeShared> slab, copy;
  {
    const Folder folder;
    large_by_slab(options, folder.path(), *slab);
  }
  {
    const Folder folder;
    large_by_zmq(options, folder.path(), *copy);
  }
  const double by_slab = median_us(slab->messages), by_copy = median_us(copy->messages);
  fmt::print("{} MiB, median of {}\n", options.megabytes, kLargeMessages - 1);
  fmt::print("  by slab            {:>9.1f} us, first {:.1f} us (maps it); the reader's own memory grew by {} KiB\n",
             by_slab, slab->messages.latency_ns[0] * 1e-3, slab->grown_kib.load());
  fmt::print("  ZeroMQ, direct     {:>9.1f} us: {:.0f} times as long\n", by_copy, by_copy / by_slab);
}

}  // namespace

}  // namespace splatbus::bench

int main(int argc, char** argv) {
  splatbus::bench::Options options;
  CLI::App app("The bus: rate and latency of small messages, and of large payloads by slab");
  app.add_option("--seconds", options.seconds, "of each run");
  app.add_option("--runs", options.runs, "of each measurement, the best of which counts");
  app.add_option("--offered", options.offered_hz, "messages a second, for the latency under load");
  app.add_option("--paced", options.paced_hz, "messages a second, for the latency of one at a time");
  app.add_option("--megabytes", options.megabytes, "MiB of the large payload");
  app.add_flag("--small-only", options.small_only, "leave the large payload out");
  app.add_flag("--bus-only", options.bus_only, "leave ZeroMQ alone out, for a profiler");
  CLI11_PARSE(app, argc, argv);
  if (!options.small_only) splatbus::bench::large_payloads(options);
  splatbus::bench::small_messages(options);
  return 0;
}
