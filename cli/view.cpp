#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <memory>
#include <stdexcept>
#include <thread>
#include <vector>

#include "metrics/image_io.h"
#include "raster/model_renderer.h"
#include "splat_options.h"
#include "splats/file.h"
#include "verbs.h"
#include "viewer/window.h"

namespace splatbus::cli {

namespace {

struct ViewOptions {
  std::string path, out, backend;
  splats::Axes axes = splats::Axes::OfFormat;
  std::uint32_t width = 1280, height = 720;
  float fov_degrees = 60;
  std::vector<float> eye, target, background{0, 0, 0};
};

/// A sphere about most of the means, a few of which are often far off.
struct Middle {
  glm::vec3 centre{0};
  float radius_m = 1;
};

float quantile(std::vector<float>& values, double part) {
  const auto nth = values.begin() + static_cast<std::ptrdiff_t>(part * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), nth, values.end());
  return *nth;
}

Middle middle_of(const GaussiansView& gaussians) {
  Middle middle;
  if (gaussians.count == 0) return middle;
  std::vector<float> values(gaussians.count);
  for (int axis = 0; axis < 3; ++axis) {
    std::copy_n(gaussians.plane(ParameterLayout::kMean + axis), gaussians.count, values.begin());
    middle.centre[axis] = quantile(values, 0.5);
  }
  for (std::size_t i = 0; i < gaussians.count; ++i) {
    const glm::vec3 mean(gaussians.plane(0)[i], gaussians.plane(1)[i], gaussians.plane(2)[i]);
    values[i] = glm::distance(mean, middle.centre);
  }
  middle.radius_m = std::max(quantile(values, 0.9), 1e-3F);
  return middle;
}

glm::vec3 vector_of(const std::vector<float>& values) {
  return {values.at(0), values.at(1), values.at(2)};
}

Camera camera_of(const ViewOptions& options, const GaussiansView& gaussians) {
  const Middle middle = middle_of(gaussians);
  const float fov = glm::radians(options.fov_degrees);
  const glm::vec3 target = options.target.empty() ? middle.centre : vector_of(options.target);
  const float distance_m = middle.radius_m / std::sin(std::min(fov, glm::half_pi<float>()) / 2);
  const glm::vec3 eye =
      options.eye.empty() ? target + distance_m * glm::normalize(glm::vec3(0.6F, 0.5F, 1)) : vector_of(options.eye);
  Camera camera = look_at(eye, target, options.width, options.height, fov);
  const float reach_m = glm::distance(eye, middle.centre) + middle.radius_m;
  camera.near_m = 0.001F * reach_m;
  camera.far_m = 100 * reach_m;
  return camera;
}

class FileView {
 public:
  explicit FileView(const ViewOptions& options)
      : file_(splats::read_file(options.path, options.axes)),
        camera_(camera_of(options, file_.gaussians.view())),
        renderer_(raster::make_model_renderer(own_backend(options.backend))) {
    scene_.light.background = vector_of(options.background);
    renderer_->take(file_.gaussians.view());
  }

  [[nodiscard]] const Camera& camera() const { return camera_; }
  [[nodiscard]] std::size_t count() const { return file_.gaussians.count(); }
  [[nodiscard]] cv::Mat draw(Camera camera) {
    camera.near_m = camera_.near_m;
    camera.far_m = camera_.far_m;
    renderer_->draw(camera, scene_, {.antialias = file_.mip}, render_);
    return metrics::from_planes(render_.color.data.data(), camera.width, camera.height, false);
  }

 private:
  splats::SplatFile file_;
  Camera camera_;
  SceneState scene_;
  std::unique_ptr<raster::ModelRenderer> renderer_;
  raster::Render render_;
};

int view(const ViewOptions& options) {
  FileView file(options);
  if (!options.out.empty()) {
    metrics::write_png(options.out, file.draw(file.camera()));
    fmt::print("{}: {} Gaussians\n", options.out, file.count());
    return 0;
  }
  viewer::Window window(file.camera(), options.path);
  Camera shown;
  for (; !window.closed(); window.poll_events()) {
    const Camera camera = window.camera();
    if (camera == shown) {
      std::this_thread::sleep_for(std::chrono::milliseconds(8));
      continue;
    }
    shown = camera;
    window.show(file.draw(camera));
  }
  return 0;
}

}  // namespace

void add_view_verb(CLI::App& app, Action& action) {
  auto options = std::make_shared<ViewOptions>();
  CLI::App* verb = app.add_subcommand("view", "Show a file of Gaussians, in a window or as a PNG file");
  verb->add_option("file", options->path, "file to show (.ply, .spz)")->required();
  verb->add_option("--out", options->out, "PNG file to write instead of opening a window");
  add_axes_option(*verb, options->axes);
  verb->add_option("--width", options->width, "pixels (default 1280)")->check(CLI::Range(8, 8192));
  verb->add_option("--height", options->height, "pixels (default 720)")->check(CLI::Range(8, 8192));
  verb->add_option("--fov", options->fov_degrees, "vertical field of view, degrees (default 60)")
      ->check(CLI::Range(1, 170));
  const auto triple = [&](const char* name, std::vector<float>& value, const char* description) {
    verb->add_option(name, value, description)->delimiter(',')->expected(3);
  };
  triple("--eye", options->eye, "x,y,z: where the camera is (default: where it sees all)");
  triple("--target", options->target, "x,y,z: what it looks at (default: the middle)");
  triple("--background", options->background, "r,g,b: linear light behind everything (default black)");
  verb->add_option("--backend", options->backend, "cpu, cuda or auto: what draws")
      ->check(CLI::IsMember({"cpu", "cuda", "auto"}));
  verb->callback([options, &action] { action = [options] { return view(*options); }; });
}

}  // namespace splatbus::cli
