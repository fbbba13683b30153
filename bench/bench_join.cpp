// Joining a large world: what a viewer's picture is worth so long after its first word, against the same picture of the
// whole model. A real streamer's hub, socket and follower; the pictures are drawn afterwards.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>
#include <zmq.hpp>

#include "bench/town_scene.h"
#include "bus/clock.h"
#include "metrics/image_io.h"
#include "metrics/metrics.h"
#include "raster/rasterizer.h"
#include "stream/display_gaussians.h"
#include "stream/follower.h"
#include "streamer/seen_pages.h"
#include "streamer/viewer_hub.h"

namespace splatbus::bench {

namespace {

struct Options {
  std::size_t gaussians = 2'000'000, cameras = 4;
  std::uint32_t seed = 1, width = 640, height = 360;
  double kbps = 50000;
  std::vector<double> after_s{0.1, 0.2, 0.3, 0.5, 1, 1.5, 2, 3};
  std::string pictures;
};

double seconds_since(std::int64_t begin_ns) {
  return static_cast<double>(bus::now_ns() - begin_ns) * 1e-9;
}

cv::Mat draw(raster::Rasterizer& rasterizer, const GaussiansView& gaussians, const Camera& camera,
             const SceneState& scene) {
  raster::Render render;
  rasterizer.render(gaussians, camera, scene, {}, render);
  return metrics::from_planes(render.color.data.data(), camera.width, camera.height, true);
}

/// A model that rests, and a hub that anybody may join, until the end of its life.
class Server {
 public:
  Server(const Options& options, const TownScene& town, const std::string& endpoint)
      : door_({endpoint}),
        hub_(door_, model_, writer_, {.viewer_kbps = options.kbps},
             {.pose = [](const auto&, const auto&) {}, .probe = {}, .quality = {}}) {
    const std::int64_t begin = bus::now_ns();
    (void)model_.observe(town.model.view());
    model_.reset_to_target();
    hub_.restart_all();
    if (const auto scene = model_.take_scene(town.scene, {})) hub_.add_scene(*scene);
    fmt::print("{} Gaussians in {} pages, offered after {:.1f} s\n", hub_.gaussians(), hub_.pages(),
               seconds_since(begin));
    for (const Camera& camera : town.walk) {
      const std::int64_t looks = bus::thread_cpu_ns();
      (void)streamer::seen_areas_px2(*model_.offered(), camera, {});
      fmt::print("to look what hides what takes {:.1f} ms\n", static_cast<double>(bus::thread_cpu_ns() - looks) * 1e-6);
    }
    thread_ = std::jthread([this](const std::stop_token& stop) {
      while (!stop.stop_requested()) {
        const std::int64_t now = bus::now_ns();
        hub_.receive(now);
        hub_.expire(now);
        const bool waits = hub_.pump(now);
        std::vector<zmq::pollitem_t> items{{door_.socket(), 0, ZMQ_POLLIN, 0}};
        zmq::poll(items, std::chrono::milliseconds(waits ? 1 : 100));
      }
    });
  }

 private:
  streamer::Endpoint door_;
  stream::PacketWriter writer_{"streamer", 1};
  stream::StreamModel model_{writer_, 1};
  streamer::ViewerHub hub_;
  std::jthread thread_;
};

struct Arrival {
  double after_s = 0;
  std::vector<std::uint8_t> packet, payload;
};

/// All that a viewer who stands there is sent in so many seconds.
std::vector<Arrival> join(const std::string& endpoint, const Camera& camera, double seconds) {
  zmq::context_t context;
  zmq::socket_t socket(context, zmq::socket_type::dealer);
  socket.set(zmq::sockopt::linger, 0);
  socket.connect(endpoint);
  const std::int64_t begin = bus::now_ns();
  stream::Follower follower({.name = "joins"}, begin);
  follower.set_camera(camera);
  std::vector<Arrival> arrivals;
  const auto bytes = [](const zmq::message_t& frame) {
    return std::vector<std::uint8_t>(frame.data<std::uint8_t>(), frame.data<std::uint8_t>() + frame.size());
  };
  while (seconds_since(begin) < seconds) {
    while (const auto packet = follower.next_outgoing(bus::now_ns())) {
      (void)socket.send(zmq::buffer(packet->packet), zmq::send_flags::dontwait);
    }
    std::vector<zmq::pollitem_t> items{{socket.handle(), 0, ZMQ_POLLIN, 0}};
    zmq::poll(items, std::chrono::milliseconds(5));
    zmq::message_t packet, payload;
    while (socket.recv(packet, zmq::recv_flags::dontwait)) {
      payload.rebuild();
      if (packet.more()) (void)socket.recv(payload);
      arrivals.push_back({.after_s = 0, .packet = bytes(packet), .payload = bytes(payload)});
      (void)follower.receive(arrivals.back().packet, arrivals.back().payload, bus::now_ns());
      arrivals.back().after_s = seconds_since(begin);
    }
  }
  const auto bye = follower.farewell();
  (void)socket.send(zmq::buffer(bye.packet), zmq::send_flags::dontwait);
  socket.set(zmq::sockopt::linger, 1000);
  return arrivals;
}

/// What is held so long after the beginning, as it is drawn.
class Held {
 public:
  explicit Held(const std::vector<Arrival>& arrivals) : arrivals_(arrivals) {}
  void advance_to(double after_s) {
    for (; next_ < arrivals_.size() && arrivals_[next_].after_s <= after_s; ++next_) {
      (void)follower_.receive(arrivals_[next_].packet, arrivals_[next_].payload, 0);
      bytes_ += arrivals_[next_].packet.size() + arrivals_[next_].payload.size();
    }
    shown_.apply(follower_.replica().take_changes());
  }
  [[nodiscard]] const stream::DisplayGaussians& shown() const { return shown_; }
  [[nodiscard]] std::size_t gaussians() const { return follower_.replica().count(); }
  [[nodiscard]] std::size_t bytes() const { return bytes_; }

 private:
  const std::vector<Arrival>& arrivals_;
  std::size_t next_ = 0, bytes_ = 0;
  stream::Follower follower_{{.name = "shows"}, 0};
  stream::DisplayGaussians shown_;
};

void run(const Options& options) {
  const TownScene town =
      make_town_scene(options.gaussians, options.seed, options.cameras, options.width, options.height);
  const std::string folder = std::filesystem::temp_directory_path() / fmt::format("bench_join_{}", ::getpid());
  std::filesystem::create_directory(folder);
  std::filesystem::permissions(folder, std::filesystem::perms::owner_all);
  const std::string endpoint = fmt::format("ipc://{}/streamer", folder);
  std::vector<std::vector<Arrival>> joins;
  {
    const Server server(options, town, endpoint);
    for (const Camera& camera : town.walk) joins.push_back(join(endpoint, camera, options.after_s.back() + 0.1));
  }
  std::filesystem::remove_all(folder);

  const auto rasterizer = raster::make_cpu_rasterizer(0);
  std::vector<double> sums(options.after_s.size());
  for (std::size_t k = 0; k < town.walk.size(); ++k) {
    const cv::Mat whole = draw(*rasterizer, town.model.view(), town.walk[k], town.scene);
    const auto save = [&](const std::string& name, const cv::Mat& picture) {
      if (!options.pictures.empty())
        metrics::write_png(fmt::format("{}/{}_{}.png", options.pictures, k, name), picture);
    };
    save("whole", whole);
    Held held(joins[k]);
    for (std::size_t t = 0; t < options.after_s.size(); ++t) {
      held.advance_to(options.after_s[t]);
      const cv::Mat picture = draw(*rasterizer, held.shown().view(), town.walk[k], town.scene);
      const double ssim = metrics::ssim(picture, whole);
      sums[t] += ssim;
      save(fmt::format("{:.1f}", options.after_s[t]), picture);
      fmt::print("camera {}, {:.1f} s: SSIM {:.4f}, {} Gaussians, {:.2f} MB\n", k, options.after_s[t], ssim,
                 held.gaussians(), static_cast<double>(held.bytes()) * 1e-6);
    }
  }
  fmt::print("mean SSIM against the whole model");
  for (std::size_t t = 0; t < sums.size(); ++t) {
    fmt::print(", {:.1f} s {:.4f}", options.after_s[t], sums[t] / static_cast<double>(town.walk.size()));
  }
  fmt::print("\n");
}

}  // namespace

}  // namespace splatbus::bench

int main(int argc, char** argv) {
  splatbus::bench::Options options;
  CLI::App app("How soon a viewer who joins a large world has its picture");
  app.add_option("--gaussians", options.gaussians, "in the world");
  app.add_option("--kbps", options.kbps, "to the viewer");
  app.add_option("--cameras", options.cameras, "places along a walk, of one join each")->check(CLI::PositiveNumber);
  app.add_option("--after", options.after_s, "seconds after the first word, ascending")->delimiter(',');
  app.add_option("--seed", options.seed, "of the world");
  app.add_option("--width", options.width, "of the pictures");
  app.add_option("--height", options.height, "of the pictures");
  app.add_option("--pictures", options.pictures, "folder for them, as PNG");
  CLI11_PARSE(app, argc, argv);
  try {
    splatbus::bench::run(options);
  } catch (const std::exception& error) {
    fmt::print(stderr, "bench_join: {}\n", error.what());
    return 1;
  }
  return 0;
}
