#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <memory>
#include <optional>
#include <stdexcept>
#include <utility>
#include <vector>

#include "gl/context.h"
#include "metrics/image_io.h"
#include "raster/model_renderer.h"
#include "splat_options.h"
#include "splats/file.h"
#include "verbs.h"
#include "view_page.h"
#include "viewer/gl/file_rows.h"
#include "viewer/gl/stage.h"
#include "viewer/loss_limit.h"
#include "viewer/window.h"

namespace splatbus::cli {

namespace {

struct ViewOptions {
  std::string path, out, backend;
  splats::Axes axes = splats::Axes::OfFormat;
  std::uint32_t width = 1280, height = 720;
  float fov_degrees = 60;
  std::vector<float> eye, target, background{0, 0, 0};
  bool page = false;
  std::optional<std::uint16_t> port;
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

/// A file, where it is seen from, and what is behind it.
struct Scene {
  explicit Scene(const ViewOptions& options)
      : file(splats::read_file(options.path, options.axes)), camera(camera_of(options, file.gaussians.view())) {
    state.light.background = vector_of(options.background);
  }
  /// With this one's depths.
  [[nodiscard]] Camera seen(Camera from) const {
    from.near_m = camera.near_m;
    from.far_m = camera.far_m;
    return from;
  }

  splats::SplatFile file;
  Camera camera;
  SceneState state;
};

cv::Mat rasterised(const Scene& scene, const std::string& backend) {
  const auto renderer = raster::make_model_renderer(own_backend(backend));
  renderer->take(scene.file.gaussians.view());
  raster::Render render;
  renderer->draw(scene.camera, scene.state, {.antialias = scene.file.mip}, render);
  return metrics::from_planes(render.color.data.data(), scene.camera.width, scene.camera.height, false);
}

/// In the current context.
std::unique_ptr<viewer::gl::Stage> make_stage(const Scene& scene) {
  auto stage = std::make_unique<viewer::gl::Stage>();
  stage->set_antialias(scene.file.mip);
  stage->add(*viewer::gl::rows_of(scene.file.gaussians.view()));
  return stage;
}

cv::Mat drawn(const Scene& scene) {
  const GlContext context;
  const viewer::gl::Picture picture = make_stage(scene)->capture(scene.camera, scene.state, viewer::gl::kSettled_s);
  return metrics::from_rgba(picture.rgba.data(), scene.camera.width, scene.camera.height);
}

constexpr std::chrono::milliseconds kIdle{100};

void show(const Scene& scene, const std::string& title) {
  viewer::Window window(scene.camera, title, viewer::Window::For::Splats);
  auto stage = make_stage(scene);
  viewer::LossLimit losses;
  const Middle middle = middle_of(scene.file.gaussians.view());
  window.set_figures({.held = scene.file.gaussians.count(), .drawn = {}, .stream = {}});
  Camera shown;
  bool due = true;
  while (!window.closed()) {
    try {
      window.poll_events();
      if (window.take_frame_all()) window.frame(middle.centre, middle.radius_m);
      const Camera camera = scene.seen(window.camera());
      due = window.take_picture_due() || due || !(shown == camera);
      if (!due) {
        window.wait_events(kIdle);
        continue;
      }
      shown = camera;
      due = false;
      stage->set_resolution(window.settings().resolution);
      stage->draw(camera, window.settings().applied_to(scene.state), viewer::gl::kSettled_s);
      window.swap();
    } catch (const ContextLost& lost) {
      losses.recover(lost, [&] {
        stage.reset();
        window.reopen();
        stage = make_stage(scene);
      });
      due = true;
    }
  }
}

int show_in_page(const ViewOptions& options) {
  splats::SplatFile file = splats::read_file(options.path, options.axes);
  PageOptions page{.path = options.path, .port = options.port, .from = {}, .background = vector_of(options.background)};
  if (!options.eye.empty() || !options.target.empty()) {
    const Camera camera = camera_of(options, file.gaussians.view());
    const glm::vec3 target =
        options.target.empty() ? middle_of(file.gaussians.view()).centre : vector_of(options.target);
    page.from = Viewpoint{.eye = camera.world_from_camera.translation, .target = target};
  }
  return view_in_page(std::move(file), page);
}

int view(const ViewOptions& options) {
  if (options.page) return show_in_page(options);
  const Scene scene(options);
  if (options.out.empty()) {
    show(scene, options.path);
    return 0;
  }
  metrics::write_png(options.out, options.backend == "gl" ? drawn(scene) : rasterised(scene, options.backend));
  fmt::print("{}: {} Gaussians\n", options.out, scene.file.gaussians.count());
  return 0;
}

}  // namespace

void add_view_verb(CLI::App& app, Action& action) {
  auto options = std::make_shared<ViewOptions>();
  CLI::App* verb =
      app.add_subcommand("view", "Show a file of Gaussians in a window or a browser, or render it to a PNG file");
  verb->add_option("file", options->path, "file to show (.ply, .spz)")->required();
  CLI::Option* const out = verb->add_option("--out", options->out, "PNG file to write instead of opening a window");
  CLI::Option* const page = verb->add_flag("--page", options->page,
                                           "serve it to browsers of this machine, until Ctrl-C, and print the address")
                                ->excludes(out);
  verb->add_option("--port", options->port,
                   "port of --page; 0: any free one (default: 7680, or another one where that is taken)")
      ->needs(page)
      ->check(CLI::Range(0, 65535));
  add_axes_option(*verb, options->axes);
  verb->add_option("--width", options->width, "width in pixels (default 1280)")
      ->check(CLI::Range(8, 8192))
      ->excludes(page);
  verb->add_option("--height", options->height, "height in pixels (default 720)")
      ->check(CLI::Range(8, 8192))
      ->excludes(page);
  verb->add_option("--fov", options->fov_degrees, "vertical field of view, degrees (default 60)")
      ->check(CLI::Range(1, 170))
      ->excludes(page);
  const auto triple = [&](const char* name, std::vector<float>& value, const char* description) {
    verb->add_option(name, value, description)->delimiter(',')->expected(3);
  };
  triple("--eye", options->eye, "camera position x,y,z (default: where it sees everything)");
  triple("--target", options->target, "point x,y,z that the camera looks at (default: the middle)");
  triple("--background", options->background, "linear background color r,g,b (default: black)");
  verb->add_option("--backend", options->backend,
                   "renderer of the PNG file: cpu, cuda, auto or gl; a window always uses OpenGL")
      ->check(CLI::IsMember({"cpu", "cuda", "auto", "gl"}))
      ->excludes(page);
  verb->callback([options, &action] { action = [options] { return view(*options); }; });
}

}  // namespace splatbus::cli
