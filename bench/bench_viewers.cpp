// What the streamer pays for viewers: a model that trains, one hub, so many viewers that read all they are sent.
#include <fmt/format.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <chrono>
#include <filesystem>
#include <random>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "bench/bench_memory.h"
#include "bench/codec_scene.h"
#include "bench/stream_reader.h"
#include "bus/clock.h"
#include "streamer/viewer_hub.h"

namespace splatbus::bench {

namespace {

struct Options {
  std::string model;
  std::vector<int> viewers{1, 100};
  int stopped = 0;
  bool slow = false;
  double seconds = 10, viewer_kbps = 9000, budget_kbps = 6000, tick_hz = 5;
  float moves = 0.002F;
};

double thread_ms() {
  return static_cast<double>(bus::thread_cpu_ns()) / 1e6;
}

/// What the viewers that read all they are sent, at any rate, have received.
struct Readers {
  double least_mbps = 0, most_mbps = 0, slow_mbps = 0, longest_gap_s = 0;
};

/// Until `stop` can be read: in a process of its own, whose memory is not the hub's. Of the viewers the first
/// `stopped` never read once they are served, and the next one, if `slow`, wants 1 Mbit/s.
[[noreturn]] void read_as(int viewers, int stopped, bool slow, const std::string& endpoint, int stop, int figures) {
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  zmq::context_t context;
  std::vector<StreamReader> readers;
  std::vector<zmq::pollitem_t> items{{nullptr, stop, ZMQ_POLLIN, 0}};
  const stream::PacketWriter writer("viewer", 1);
  for (int k = 0; k < viewers; ++k) {
    StreamReader& reader = readers.emplace_back(StreamReader::connect(context, endpoint));
    reader.max_kbps = slow && k == stopped ? 1000U : 0U;
    reader.reads = k >= stopped;
  }
  for (StreamReader& reader : readers) {
    if (reader.reads) items.push_back({reader.socket.handle(), 0, ZMQ_POLLIN, 0});
  }
  const std::int64_t begin_ns = bus::now_ns();
  std::int64_t greeted_ns = 0;
  while (items[0].revents == 0) {  // its other end is closed, not written to
    const std::int64_t now_ns = bus::now_ns();
    const bool greets = now_ns - greeted_ns > 200'000'000;  // strangers are answered so many times a second
    if (greets) greeted_ns = now_ns;
    for (StreamReader& reader : readers) {
      if (greets) reader.greet(writer);
      reader.read(now_ns);
      reader.say(writer, now_ns);
    }
    zmq::poll(items, std::chrono::milliseconds(10));
  }
  const double seconds = static_cast<double>(bus::now_ns() - begin_ns) * 1e-9;
  Readers all{.least_mbps = 1e9};
  for (const StreamReader& reader : readers) {
    const double mbps = static_cast<double>(reader.bytes) * 8e-6 / seconds;
    if (reader.max_kbps != 0) all.slow_mbps = mbps;
    if (!reader.reads || reader.max_kbps != 0) continue;
    all.least_mbps = std::min(all.least_mbps, mbps);
    all.most_mbps = std::max(all.most_mbps, mbps);
    all.longest_gap_s = std::max(all.longest_gap_s, static_cast<double>(reader.longest_gap_ns) * 1e-9);
  }
  ::_exit(::write(figures, &all, sizeof all) == sizeof all ? 0 : 1);
}

struct Cost {
  double tick_ms = 0, hub_ms = 0, mib = 0;
  Readers readers;
};

Cost measure(const Options& options, const CodecScene& scene, int viewers) {
  const std::string folder = std::filesystem::temp_directory_path() / fmt::format("bench_viewers_{}", ::getpid());
  std::filesystem::create_directories(folder);
  const std::string endpoint = fmt::format("ipc://{}/{}", folder, viewers);
  std::array<int, 2> stop{}, figures{};
  if (::pipe(stop.data()) != 0 || ::pipe(figures.data()) != 0) throw std::runtime_error("no pipe");
  const pid_t readers = ::fork();
  if (readers == 0) {
    ::close(stop[1]);
    read_as(viewers, options.stopped, options.slow, endpoint, stop[0], figures[1]);
  }
  ::close(stop[0]);
  ::close(figures[1]);
  Cost cost;
  {
    streamer::Endpoint door({endpoint});
    const stream::PacketWriter writer("streamer", 1);
    stream::StreamModel model(writer, 1);
    const streamer::HubOptions hub_options{
        .max_viewers = 4096, .viewer_timeout_s = 3600, .viewer_kbps = options.viewer_kbps};
    streamer::ViewerHub hub(door, model, writer, hub_options, {});
    GaussiansBuffer gaussians = GaussiansBuffer::copy_of(scene.model.view());
    std::mt19937 random(1);
    std::normal_distribution<float> normal(0, options.moves);
    (void)model.observe(gaussians.view());
    model.reset_to_target();
    hub.restart_all();
    const double before = used_mib(Device::Cpu);
    while (hub.viewers() < static_cast<std::size_t>(viewers)) hub.receive(bus::now_ns());
    const std::int64_t begin = bus::now_ns();
    std::int64_t next_tick = begin;
    int ticks = 0;
    while (static_cast<double>(bus::now_ns() - begin) < options.seconds * 1e9) {
      const bool due = bus::now_ns() >= next_tick;
      if (due) {
        next_tick += static_cast<std::int64_t>(1e9 / options.tick_hz);
        ++ticks;
        for (float& value : gaussians.parameters) value += normal(random);
        const double from = thread_ms();
        (void)model.observe(gaussians.view());
        model.set_holders(hub.followed_pages());
        model.make_tick(options.budget_kbps * 125 / options.tick_hz, {});
        cost.tick_ms += thread_ms() - from;
      }
      const double from = thread_ms();
      if (due) hub.add(model.take_update());
      hub.receive(bus::now_ns());
      hub.pump(bus::now_ns());
      cost.hub_ms += thread_ms() - from;
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    cost.tick_ms /= ticks;
    cost.hub_ms /= ticks;
    cost.mib = used_mib(Device::Cpu) - before;
  }
  ::close(stop[1]);
  const bool read = ::read(figures[0], &cost.readers, sizeof cost.readers) == sizeof cost.readers;
  ::close(figures[0]);
  if (!read) throw std::runtime_error("the viewers' process has ended");
  ::waitpid(readers, nullptr, 0);
  std::filesystem::remove_all(folder);
  return cost;
}

void run(const Options& options) {
  const CodecScene scene = load_codec_scene(options.model, -1);
  fmt::print("{}: {} Gaussians\n", scene.name, scene.model.count());
  for (const int viewers : options.viewers) {
    const Cost cost = measure(options, scene, viewers);
    const Readers& readers = cost.readers;
    fmt::print(
        "{:>4} viewers: encoding {:.1f} ms a tick, all else {:.1f} ms a tick, {:.1f} MiB, {:.2f} to {:.2f} Mbit/s, "
        "longest gap {:.2f} s{}\n",
        viewers, cost.tick_ms, cost.hub_ms, cost.mib, readers.least_mbps, readers.most_mbps, readers.longest_gap_s,
        options.slow ? fmt::format(", the slow one {:.2f} Mbit/s", readers.slow_mbps) : "");
  }
}

}  // namespace

}  // namespace splatbus::bench

int main(int argc, char** argv) {
  splatbus::bench::Options options;
  CLI::App app("Viewers of one streamer: time and memory");
  app.add_option("model", options.model, "a PLY file or a world folder")->required();
  app.add_option("--viewers", options.viewers, "one run each");
  app.add_option("--stopped", options.stopped, "viewers among them that do not read");
  app.add_flag("--slow", options.slow, "one among them wants 1 Mbit/s");
  app.add_option("--seconds", options.seconds, "of a run");
  app.add_option("--viewer-kbps", options.viewer_kbps, "to each");
  app.add_option("--budget-kbps", options.budget_kbps, "of deltas");
  app.add_option("--tick-hz", options.tick_hz, "updates a second");
  app.add_option("--moves", options.moves, "deviation of what a tick adds to each parameter");
  CLI11_PARSE(app, argc, argv);
  splatbus::bench::run(options);
  return 0;
}
