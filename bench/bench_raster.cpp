// Time of rendering and of training steps on one scene and a ring of cameras, stage by stage.
#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <functional>
#include <glm/gtc/quaternion.hpp>
#include <map>
#include <nlohmann/json.hpp>
#include <numeric>
#include <random>
#include <stdexcept>

#include "fmt/core.h"
#include "gaussians/model.h"
#include "raster/adam.h"
#include "raster/loss.h"
#include "raster/rasterizer.h"

namespace {

using namespace splatbus;
using Clock = std::chrono::steady_clock;

struct Arguments {
  std::string scene, cameras, json, backend = "cpu", mode = "train", appearance = "radiance";
  int sh = 3, batch = 1, threads = 0, iterations = 60, warmup = 10, active_channels = 0;
  bool separate_adam = false;
};

/// "world_to_camera": 4x4 rows, "intrinsics": 3x3 rows, OpenCV axes.
std::vector<Camera> read_cameras(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error(path + ": cannot be opened");
  const nlohmann::json document = nlohmann::json::parse(file);
  std::vector<Camera> cameras;
  for (std::size_t k = 0; k < document.at("world_to_camera").size(); ++k) {
    const auto& m = document["world_to_camera"][k];
    const auto& intrinsics = document.at("intrinsics").at(k);
    Camera camera;
    camera.width = document.at("width");
    camera.height = document.at("height");
    camera.fx = intrinsics[0][0];
    camera.fy = intrinsics[1][1];
    camera.cx = intrinsics[0][2];
    camera.cy = intrinsics[1][2];
    glm::mat3 rotation;
    glm::vec3 translation;
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 3; ++column) rotation[column][row] = m[row][column];
      translation[row] = m[row][3];
    }
    camera.world_from_camera = inverse(Rigid{glm::normalize(glm::quat_cast(rotation)), translation});
    cameras.push_back(camera);
  }
  return cameras;
}

/// The scene in the layout asked for: fewer SH bands, or as a transfer model with its DC colour as albedo.
GaussiansBuffer convert(const GaussiansBuffer& from, const Arguments& arguments) {
  const ParameterLayout layout = arguments.appearance == "transfer"
                                     ? ParameterLayout{Appearance::Transfer, 0}
                                     : ParameterLayout{Appearance::Radiance, arguments.sh};
  GaussiansBuffer to(layout, from.count());
  const GaussiansView source = from.view();
  const int shared = std::min(layout.channels(), from.layout().channels());
  for (int c = 0; c < (layout.appearance == Appearance::Transfer ? 11 : shared); ++c) {
    std::copy_n(source.plane(c), from.count(), to.parameters.data() + static_cast<std::size_t>(c) * to.stride());
  }
  for (std::size_t i = 0; i < from.count() && layout.appearance == Appearance::Transfer; ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      to.parameters[(11 + c) * to.stride() + i] = 0.5F + 0.28209479F * source.plane(11 + static_cast<int>(c))[i];
    }
    to.normal[2 * to.stride() + i] = 1;
    to.visibility[i] = 1;
  }
  return to;
}

std::vector<std::uint8_t> to_target(const raster::Image& image, bool linear) {
  const std::size_t pixels = std::size_t{image.width} * image.height;
  std::vector<std::uint8_t> rgba(4 * pixels, 255);
  for (std::size_t i = 0; i < pixels; ++i) {
    for (std::uint32_t c = 0; c < 3; ++c) {
      const float value = image.plane(c)[i];
      const float shown = linear ? srgb_from_linear(value) : std::clamp(value, 0.0F, 1.0F);
      rgba[4 * i + c] = static_cast<std::uint8_t>(255 * shown + 0.5F);
    }
  }
  return rgba;
}

std::vector<float> learning_rates(const ParameterLayout& layout) {
  std::vector<float> rates(static_cast<std::size_t>(layout.channels()), 2.5e-3F / 20);
  std::fill_n(rates.begin(), 3, 1.6e-4F);
  std::fill_n(rates.begin() + 3, 3, 5e-3F);
  std::fill_n(rates.begin() + 6, 4, 1e-3F);
  rates[10] = 2.5e-2F;
  std::fill_n(rates.begin() + 11, 3, 2.5e-3F);
  return rates;
}

double median(std::vector<double> values) {
  if (values.empty()) return 0;
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2), values.end());
  return values[values.size() / 2];
}

class Stages {
 public:
  template <class Body>
  void time(const std::string& name, const Body& body) {
    const auto begin = Clock::now();
    body();
    add(name, std::chrono::duration<double, std::milli>(Clock::now() - begin).count());
  }
  void add(const std::string& name, double milliseconds) { step_[name] += milliseconds; }
  void end_step(bool counted) {
    for (const auto& [name, milliseconds] : step_) {
      if (counted) all_[name].push_back(milliseconds);
    }
    step_.clear();
  }
  [[nodiscard]] nlohmann::json medians() const {
    nlohmann::json out;
    for (const auto& [name, values] : all_) out[name] = median(values);
    return out;
  }

 private:
  std::map<std::string, double> step_;
  std::map<std::string, std::vector<double>> all_;
};

nlohmann::json run(const Arguments& arguments) {
  GaussiansBuffer model = convert(read_ply(arguments.scene), arguments);
  const std::vector<Camera> cameras = read_cameras(arguments.cameras);
  SceneState scene;
  for (int c = 0; c < 3; ++c) scene.light.ambient_sh[0][c] = 1 / 0.2820948F;
  scene.light.sun_irradiance = glm::vec3(1);
  const auto rasterizer = raster::make_cpu_rasterizer(arguments.threads);
  const bool transfer = model.layout().appearance == Appearance::Transfer;

  raster::Render render;
  std::vector<std::vector<std::uint8_t>> targets;
  double mean_image = 0;
  for (const Camera& camera : cameras) {
    rasterizer->render(model.view(), camera, scene, {}, render);
    const auto& data = render.color.data;
    mean_image += std::accumulate(data.begin(), data.end(), 0.0) / static_cast<double>(data.size());
    targets.push_back(to_target(render.color, transfer));
  }
  mean_image /= static_cast<double>(cameras.size());

  // The targets are the model's own pictures; training starts from disturbed colours and means.
  std::mt19937 generator(1);
  const auto noise = [&] { return static_cast<float>(generator() >> 8U) / 8388608.0F - 1; };
  for (std::size_t i = 0; i < model.count() && arguments.mode == "train"; ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      model.parameters[c * model.stride() + i] += 0.004F * noise();
      model.parameters[(11 + c) * model.stride() + i] += 0.1F * noise();
    }
  }

  raster::ParameterGradient gradient;
  gradient.active_channels = arguments.active_channels;
  raster::RenderGradient render_gradient;
  raster::Adam adam;
  adam.resize(model.layout(), model.count(), model.stride());
  const std::vector<float> rates = learning_rates(model.layout());
  const raster::LossOptions loss_options{0.2F, transfer};

  const bool fused = arguments.batch == 1 && !arguments.separate_adam;

  Stages stages;
  std::vector<double> milliseconds;
  double loss = 0;
  std::size_t view = 0;
  for (int step = -arguments.warmup; step < arguments.iterations; ++step) {
    const auto begin = Clock::now();
    if (arguments.mode == "train") {
      stages.time("clear", [&] { fused ? gradient.clear_statistics(model.view()) : gradient.clear(model.view()); });
    }
    for (int b = 0; b < arguments.batch; ++b, view = (view + 1) % cameras.size()) {
      if (arguments.mode == "train") {
        rasterizer->forward(model.view(), cameras[view], scene, {}, render);
        stages.time("loss", [&] {
          loss = image_loss(render.color, targets[view].data(), loss_options, render_gradient.color);
        });
        if (fused) {
          rasterizer->backward_step(render_gradient, rates, adam, model.parameters.data(), gradient);
        } else {
          rasterizer->backward(render_gradient, gradient);
        }
      } else {
        rasterizer->render(model.view(), cameras[view], scene, {}, render);
      }
      for (const raster::StageTime& stage : rasterizer->stage_times()) stages.add(stage.name, stage.milliseconds);
    }
    if (arguments.mode == "train" && !fused) {
      stages.time("adam",
                  [&] { adam.step(model.parameters.data(), model.flags.data(), gradient, rates, arguments.threads); });
    }
    const double elapsed = std::chrono::duration<double, std::milli>(Clock::now() - begin).count();
    stages.end_step(step >= 0);
    if (step >= 0) milliseconds.push_back(elapsed);
  }

  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const double step_ms = median(milliseconds);
  return {{"gaussians", model.count()},
          {"width", cameras.at(0).width},
          {"height", cameras.at(0).height},
          {"mode", arguments.mode},
          {"appearance", arguments.appearance},
          {"sh", transfer ? -1 : arguments.sh},
          {"active_channels", arguments.active_channels},
          {"batch", arguments.batch},
          {"ms_median", step_ms},
          {"ms_min", *std::min_element(milliseconds.begin(), milliseconds.end())},
          {"views_per_s", 1000.0 * arguments.batch / step_ms},
          {"peak_mib", static_cast<double>(usage.ru_maxrss) / 1024},
          {"stages", stages.medians()},
          {"mean_image", mean_image},
          {"loss", loss}};
}

}  // namespace

int main(int argc, char** argv) {
  Arguments arguments;
  CLI::App app("Times the rasteriser on a PLY scene and a cameras file.");
  app.add_option("--scene", arguments.scene, "PLY in the 3DGS layout")->required();
  app.add_option("--cams", arguments.cameras, "JSON: width, height, world_to_camera, intrinsics")->required();
  app.add_option("--backend", arguments.backend)->check(CLI::IsMember({"cpu"}));
  app.add_option("--mode", arguments.mode)->check(CLI::IsMember({"forward", "train"}));
  app.add_option("--appearance", arguments.appearance)->check(CLI::IsMember({"radiance", "transfer"}));
  app.add_option("--sh", arguments.sh, "SH degree of radiance")->check(CLI::Range(0, 3));
  app.add_option("--active-channels", arguments.active_channels, "channels trained, 0: all")->check(CLI::Range(0, 59));
  app.add_option("--batch", arguments.batch, "views a step")->check(CLI::Range(1, 64));
  app.add_option("--threads", arguments.threads, "0: all cores")->check(CLI::Range(0, 1024));
  app.add_option("--iterations", arguments.iterations)->check(CLI::Range(1, 1000000));
  app.add_option("--warmup", arguments.warmup)->check(CLI::Range(0, 100000));
  app.add_flag("--separate-adam", arguments.separate_adam, "backward and Adam as two passes even at a batch of 1");
  app.add_option("--json", arguments.json, "where the result goes; standard output if absent");
  CLI11_PARSE(app, argc, argv);
  try {
    const std::string text = run(arguments).dump(2);
    if (arguments.json.empty()) {
      fmt::print("{}\n", text);
    } else {
      std::ofstream(arguments.json) << text << '\n';
    }
  } catch (const std::exception& error) {
    fmt::print(stderr, "bench_raster: {}\n", error.what());
    return 1;
  }
  return 0;
}
