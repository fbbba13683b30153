// What the streamer pays for viewers: a model that trains, one hub, so many viewers that read all they are sent.
#include <fmt/format.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <filesystem>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "bench/bench_memory.h"
#include "bench/codec_scene.h"
#include "bus/clock.h"
#include "streamer/viewer_hub.h"

namespace splatbus::bench {

namespace {

struct Options {
  std::string model;
  std::vector<int> viewers{1, 100};
  double seconds = 10, viewer_kbps = 9000, budget_kbps = 6000, tick_hz = 5;
  float moves = 0.002F;
};

double thread_ms() {
  timespec time{};
  ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) * 1e3 + static_cast<double>(time.tv_nsec) / 1e6;
}

/// Greets, and reads until it is killed: in a process of its own, whose memory is not the hub's.
[[noreturn]] void read_as(int viewers, const std::string& endpoint) {
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  zmq::context_t context;
  std::vector<zmq::socket_t> sockets;
  std::vector<zmq::pollitem_t> items;
  std::vector<bool> served(static_cast<std::size_t>(viewers), false);
  const stream::PacketWriter writer("viewer", 1);
  for (int k = 0; k < viewers; ++k) {
    zmq::socket_t& socket = sockets.emplace_back(context, zmq::socket_type::dealer);
    socket.set(zmq::sockopt::linger, 0);
    socket.connect(endpoint);
  }
  for (zmq::socket_t& socket : sockets) items.push_back({socket.handle(), 0, ZMQ_POLLIN, 0});
  const auto hello =
      writer.write(0, 0, wire::Body::Hello, [](auto& builder) { return wire::CreateHelloDirect(builder, "viewer"); });
  zmq::message_t frame;
  while (true) {
    // Again, until it is answered: strangers are so many times a second.
    for (std::size_t k = 0; k < sockets.size(); ++k) {
      if (!served[k]) (void)sockets[k].send(zmq::buffer(hello.packet), zmq::send_flags::dontwait);
    }
    zmq::poll(items, std::chrono::milliseconds(200));
    for (std::size_t k = 0; k < sockets.size(); ++k) {
      while (sockets[k].recv(frame, zmq::recv_flags::dontwait)) served[k] = true;
    }
  }
}

struct Cost {
  double tick_ms = 0, hub_ms = 0, mib = 0, mbps = 0;
};

Cost measure(const Options& options, const CodecScene& scene, int viewers) {
  const std::string folder = std::filesystem::temp_directory_path() / fmt::format("bench_viewers_{}", ::getpid());
  std::filesystem::create_directories(folder);
  const std::string endpoint = fmt::format("ipc://{}/{}", folder, viewers);
  const pid_t readers = ::fork();
  if (readers == 0) read_as(viewers, endpoint);
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
        model.set_holders(hub.holders());
        model.make_tick(options.budget_kbps * 125 / options.tick_hz, {});
        cost.tick_ms += thread_ms() - from;
      }
      const double from = thread_ms();
      if (due) hub.add(model.take_update());
      hub.pump(bus::now_ns());
      cost.hub_ms += thread_ms() - from;
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    cost.tick_ms /= ticks;
    cost.hub_ms /= ticks;
    cost.mib = used_mib(Device::Cpu) - before;
    const auto sent = hub.statistics().close_window(bus::now_ns());
    for (const auto& type : sent.types) cost.mbps += static_cast<double>(type.total_bytes) * 8e-6 / options.seconds;
  }
  ::kill(readers, SIGKILL);
  ::waitpid(readers, nullptr, 0);
  std::filesystem::remove_all(folder);
  return cost;
}

void run(const Options& options) {
  const CodecScene scene = load_codec_scene(options.model, -1);
  fmt::print("{}: {} Gaussians\n", scene.name, scene.model.count());
  for (const int viewers : options.viewers) {
    const Cost cost = measure(options, scene, viewers);
    fmt::print("{:>4} viewers: encoding {:.1f} ms a tick, all else {:.1f} ms a tick, {:.1f} MiB, {:.1f} Mbit/s each\n",
               viewers, cost.tick_ms, cost.hub_ms, cost.mib, cost.mbps / viewers);
  }
}

}  // namespace

}  // namespace splatbus::bench

int main(int argc, char** argv) {
  splatbus::bench::Options options;
  CLI::App app("Viewers of one streamer: time and memory");
  app.add_option("model", options.model, "a PLY file or a world folder")->required();
  app.add_option("--viewers", options.viewers, "one run each");
  app.add_option("--seconds", options.seconds, "of a run");
  app.add_option("--viewer-kbps", options.viewer_kbps, "to each");
  app.add_option("--budget-kbps", options.budget_kbps, "of deltas");
  app.add_option("--tick-hz", options.tick_hz, "updates a second");
  app.add_option("--moves", options.moves, "deviation of what a tick adds to each parameter");
  CLI11_PARSE(app, argc, argv);
  splatbus::bench::run(options);
  return 0;
}
