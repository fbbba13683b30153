// What streamers that share viewers and pages cost: real ones, each a process of its own, on one bus, with a model of
// which all moves and viewers that read all they are sent.
#include <fmt/format.h>
#include <sched.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>
#include <optional>
#include <random>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "bench/processes.h"
#include "bench/stream_reader.h"
#include "bus/broker.h"
#include "bus/clock.h"
#include "bus/subscriber.h"
#include "model/page_store.h"
#include "wire/stream_generated.h"

namespace splatbus::bench {

namespace {

using namespace std::chrono_literals;

struct Options {
  std::string streamer = "build/release/bin/splatbus-streamer";
  std::vector<int> streamers{1, 2};
  std::size_t gaussians = 50'000;
  int viewers = 100;
  double warm_s = 15, seconds = 20, viewer_kbps = 9000, budget_kbps = 6000, tick_hz = 5;
  float moves = 0.002F;
  bool apart = false;
};

struct Shared {
  std::uint64_t bytes = 0, least = 0;  ///< that readers have had, all and the one with the fewest
};

/// This process, and what it starts, on the first processor, or on all the others.
void stay_on(bool first) {
  cpu_set_t processors;
  CPU_ZERO(&processors);
  const long all = ::sysconf(_SC_NPROCESSORS_ONLN);
  for (long k = first ? 0 : 1; k < (first ? 1 : all); ++k) CPU_SET(static_cast<std::size_t>(k), &processors);
  if (::sched_setaffinity(0, sizeof processors, &processors) != 0) throw std::runtime_error("cannot choose processors");
}

[[noreturn]] void run_broker(const bus::Address& address) {
  bus_service::BrokerOptions options;
  options.address = address;
  bus_service::Broker broker(options);
  broker.start();
  while (true) std::this_thread::sleep_for(1h);
}

/// A plain of Gaussians about as far apart as they are large, in the pages that the trainer would put them in.
void insert_plain(model::PageStore& store, std::size_t count) {
  constexpr float kStep_m = 0.02F;
  const auto across = static_cast<std::size_t>(std::ceil(std::sqrt(static_cast<double>(count))));
  std::mt19937 random(1);
  std::uniform_real_distribution<float> unit(0, 1);
  std::vector<float> mean(3 * count), scale(3 * count), rotation(4 * count), opacity(count, 2), albedo(3 * count),
      normal(3 * count), seen(count, 1);
  const std::vector<std::uint32_t> object(count, 0);
  for (std::size_t i = 0; i < count; ++i) {
    mean[i] = kStep_m * (static_cast<float>(i % across) + unit(random));
    mean[count + i] = 0.1F * unit(random);
    mean[2 * count + i] = kStep_m * (static_cast<float>(i / across) + unit(random));
    rotation[i] = normal[count + i] = 1;
    for (std::size_t c = 0; c < 3; ++c) {
      scale[c * count + i] = std::log(kStep_m * (0.3F + unit(random)));
      albedo[c * count + i] = unit(random);
    }
  }
  store.insert({.stride = count,
                .mean = mean.data(),
                .log_scale = scale.data(),
                .rotation = rotation.data(),
                .opacity_logit = opacity.data(),
                .albedo = albedo.data(),
                .normal = normal.data(),
                .visibility = seen.data(),
                .object_id = object.data()},
               count, {}, 1, 1);
}

/// As a trainer's averages: all of them, in place.
[[noreturn]] void run_trainer(const Options& options, const bus::Address& address) {
  const auto context = bus::Context::create(address, "trainer");
  const bus::Publisher publisher(context);
  model::PageStore store(context, {}, {.max_gaussians = 2 * options.gaussians});
  insert_plain(store, options.gaussians);
  store.refresh_bounds();
  store.publish(publisher);
  std::mt19937 random(2);
  std::normal_distribution<float> normal(0, options.moves);
  std::vector<float> steps(std::size_t{1} << 16);
  for (float& step : steps) step = normal(random);
  const GaussiansView view = store.average_view();
  auto next = std::chrono::steady_clock::now();
  while (true) {
    for (const IndexRange& range : view.ranges) {
      for (int c = 0; c < view.layout.channels(); ++c) {
        float* const row = store.average() + view.offset(range.first) + static_cast<std::size_t>(c) * view.stride;
        const std::size_t at = random() % (steps.size() - kPageLanes);
        for (std::uint32_t lane = 0; lane < range.count; ++lane) row[lane] += steps[at + lane];
      }
    }
    next += std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::duration<double>(1 / options.tick_hz));
    std::this_thread::sleep_until(next);
  }
}

void run_streamer(const Options& options, const bus::Address& address, const std::string& name) {
  if (options.apart) stay_on(true);
  const std::string bus = address.text();
  const auto rate = fmt::format("viewer_kbps={}", options.viewer_kbps), hz = fmt::format("tick_hz={}", options.tick_hz);
  const auto budget = fmt::format("budget_kbps={}", options.budget_kbps);
  ::execl(options.streamer.c_str(), options.streamer.c_str(), "--bus", bus.c_str(), "--name", name.c_str(), "--backend",
          "cpu", "--log-level", "warn", "--set", "max_viewers=4096", "--set", rate.c_str(), "--set", budget.c_str(),
          "--set", hz.c_str(), nullptr);
  throw std::runtime_error("cannot run " + options.streamer);
}

[[noreturn]] void run_readers(int viewers, const std::vector<std::string>& endpoints, Shared& shared) {
  zmq::context_t context;
  context.set(zmq::ctxopt::max_sockets, viewers + 16);
  std::vector<StreamReader> readers;
  std::vector<zmq::pollitem_t> items;
  const stream::PacketWriter writer("viewer", 1);
  for (int k = 0; k < viewers; ++k) {
    readers.push_back(StreamReader::connect(context, endpoints[static_cast<std::size_t>(k) % endpoints.size()]));
  }
  for (StreamReader& reader : readers) items.push_back({reader.socket.handle(), 0, ZMQ_POLLIN, 0});
  std::int64_t greeted_ns = 0;
  while (true) {
    const std::int64_t now_ns = bus::now_ns();
    const bool greets = now_ns - greeted_ns > 300'000'000;
    if (greets) greeted_ns = now_ns;
    std::uint64_t all = 0, least = ~std::uint64_t{0};
    for (StreamReader& reader : readers) {
      if (greets) reader.greet(writer);
      reader.read(now_ns);
      reader.say(writer, now_ns);
      all += reader.bytes;
      least = std::min(least, reader.bytes);
    }
    shared.bytes = all;
    shared.least = least;
    zmq::poll(items, 10ms);
  }
}

double cpu_ms(pid_t pid) {
  std::ifstream file(fmt::format("/proc/{}/stat", pid));
  std::string text((std::istreambuf_iterator<char>(file)), {});
  std::istringstream fields(text.substr(text.rfind(')') + 2));
  std::string skipped;
  for (int k = 0; k < 11; ++k) fields >> skipped;
  double user = 0, system = 0;
  fields >> user >> system;
  return 1e3 * (user + system) / static_cast<double>(::sysconf(_SC_CLK_TCK));
}

/// Throws std::runtime_error when one of them has not come after a while.
void wait_for_files(const std::vector<std::string>& paths) {
  const auto end = std::chrono::steady_clock::now() + 30s;
  for (const std::string& path : paths) {
    while (!std::filesystem::exists(path)) {
      if (std::chrono::steady_clock::now() > end) throw std::runtime_error(path + " has not come");
      std::this_thread::sleep_for(10ms);
    }
  }
}

/// Of one streamer, milliseconds of CPU time a tick.
struct Cost {
  double encode = 0, send = 0, process = 0;
  int offers = 0;
  std::uint32_t viewers = 0;
  [[nodiscard]] double both() const { return encode + send; }
};

std::map<std::string, Cost> measure(const Options& options, int streamers) {
  const std::string folder = std::filesystem::temp_directory_path() / fmt::format("bench_streamers_{}", ::getpid());
  std::filesystem::create_directories(folder);
  std::filesystem::permissions(folder, std::filesystem::perms::owner_all);
  const bus::Address address = bus::Address::parse("ipc://" + folder);
  const SharedMemory<Shared> shared;
  if (options.apart) stay_on(false);
  std::map<std::string, Cost> costs;
  {
    std::vector<Process> processes;
    std::map<std::string, pid_t> pids;
    std::vector<std::string> sockets, endpoints;
    std::fflush(stdout);  // what is buffered would be written by each
    processes.emplace_back([&] { run_broker(address); });
    processes.emplace_back([&] { run_trainer(options, address); });
    for (int k = 1; k <= streamers; ++k) {
      const auto name = fmt::format("streamer-{}", k);
      sockets.push_back(fmt::format("{}/{}", folder, name));
      endpoints.push_back("ipc://" + sockets.back());
      processes.emplace_back([&] { run_streamer(options, address, name); });
      pids[name] = processes.back().pid();
    }
    wait_for_files(sockets);
    processes.emplace_back([&] { run_readers(options.viewers, endpoints, *shared); });
    std::this_thread::sleep_for(std::chrono::duration<double>(options.warm_s));

    bus::Subscriber subscriber(bus::Context::create(address, "bench"));
    subscriber.on(topics::kStreamerOffer, [&](const wire::StreamerOffer& offer, const bus::Message&) {
      Cost& cost = costs[offer.header()->source()->str()];
      cost.encode += offer.encode_ms();
      cost.send += offer.send_ms();
      cost.viewers = offer.viewers();
      ++cost.offers;
    });
    std::map<std::string, double> before;
    for (const auto& [name, pid] : pids) before[name] = cpu_ms(pid);
    const std::uint64_t bytes = shared->bytes;
    const std::int64_t begin_ns = bus::now_ns(), end_ns = begin_ns + static_cast<std::int64_t>(options.seconds * 1e9);
    while (bus::now_ns() < end_ns) subscriber.dispatch_all(100ms);
    const double seconds = static_cast<double>(bus::now_ns() - begin_ns) * 1e-9;
    for (auto& [name, cost] : costs) {
      cost.encode /= cost.offers;
      cost.send /= cost.offers;
      cost.process = (cpu_ms(pids.at(name)) - before.at(name)) / (seconds * options.tick_hz);
    }
    fmt::print("{} streamer{}, {:.2f} Mbit/s to each of {} viewers\n", streamers, streamers == 1 ? "" : "s",
               static_cast<double>(shared->bytes - bytes) * 8e-6 / seconds / options.viewers, options.viewers);
  }
  std::filesystem::remove_all(folder);
  return costs;
}

void run(const Options& options) {
  std::optional<Cost> alone;
  for (const int streamers : options.streamers) {
    Cost busiest;
    for (const auto& [name, cost] : measure(options, streamers)) {
      fmt::print("  {}: {} viewers, encoding {:.2f}, sending {:.2f}, both {:.2f}; the whole process {:.2f} ms a tick\n",
                 name, cost.viewers, cost.encode, cost.send, cost.both(), cost.process);
      if (cost.both() > busiest.both()) busiest = cost;
    }
    if (!alone) alone = busiest;
    fmt::print("  headroom: {:.2f} times (of the whole process {:.2f})\n", alone->both() / busiest.both(),
               alone->process / busiest.process);
  }
}

}  // namespace

}  // namespace splatbus::bench

int main(int argc, char** argv) {
  splatbus::bench::Options options;
  CLI::App app("Streamers that share viewers: CPU time a tick");
  app.add_option("--streamer", options.streamer, "the program");
  app.add_option("--streamers", options.streamers, "how many; one run each, and the first is what others compare with");
  app.add_option("--gaussians", options.gaussians, "of the model");
  app.add_option("--viewers", options.viewers, "of all streamers together");
  app.add_option("--warm-up", options.warm_s, "seconds before");
  app.add_option("--seconds", options.seconds, "of a run");
  app.add_option("--viewer-kbps", options.viewer_kbps, "to each viewer");
  app.add_option("--budget-kbps", options.budget_kbps, "of deltas");
  app.add_option("--tick-hz", options.tick_hz, "updates a second");
  app.add_option("--moves", options.moves, "deviation of what a tick adds to each parameter");
  app.add_flag("--apart", options.apart,
               "streamers on one processor and all else on the others, so that none of them slows another one down");
  CLI11_PARSE(app, argc, argv);
  splatbus::bench::run(options);
  return 0;
}
