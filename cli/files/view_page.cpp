#include "view_page.h"

#include <fmt/format.h>

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <stdexcept>
#include <thread>

#include "bus/publisher.h"
#include "gateway_url.h"
#include "launch_file.h"
#include "launch_plan.h"
#include "model/page_filling.h"
#include "model/page_store.h"
#include "parameter_check.h"
#include "supervised_run.h"
#include "verbs.h"
#include "wire/convert.h"
#include "wire/scene_generated.h"

namespace splatbus::cli {

namespace {

constexpr std::chrono::milliseconds kTurn{50};

/// Where the gateway looks for it.
void require_page() {
  const std::filesystem::path page = program_directory().parent_path() / "share/splatbus/web/index.html";
  if (std::filesystem::exists(page)) return;
  throw std::runtime_error(
      "this build has no page, which needs emscripten, Node.js and npm: leave out --page for a window");
}

/// The services, at a place that can be had.
struct Launch {
  LaunchFile file;
  GatewayUrl gateway;
};

Launch launch_of(const splats::SplatFile& file, const PageOptions& options) {
  Launch launch{.file = read_launch_file(default_launch_file("view.yaml").string()), .gateway = {}};
  const auto gateway = settle_gateway(launch.file, options.port.value_or(kGatewayPort));
  if (!gateway) throw std::runtime_error(launch.file.path + ": no gateway");
  if (options.port && gateway->elsewhere) {
    throw std::runtime_error(fmt::format("port {} is taken, or this user may not use it", *options.port));
  }
  launch.gateway = *gateway;
  if (!file.mip) apply_override(launch.file, "gateway.mip=false");
  return launch;
}

/// What a trainer and a capture-bridge would say of the model.
class StillPublisher {
 public:
  /// Waits for the broker.
  StillPublisher(std::shared_ptr<bus::Context> context, const GaussiansView& gaussians)
      : publisher_(context), store_(std::move(context), gaussians.layout, {.max_gaussians = gaussians.count}) {
    model::fill_frozen(store_, gaussians);
  }
  [[nodiscard]] std::size_t count() const { return store_.count(); }

  void publish(const glm::vec3& background) const {
    SceneState scene{.version = 1};
    scene.light.background = background;
    publisher_.publish(topics::kSceneState, [&](auto& builder, auto header) {
      return wire::CreateSceneUpdate(builder, header, to_wire(builder, scene));
    });
    store_.publish(publisher_);
  }

 private:
  bus::Publisher publisher_;
  model::PageStore store_;
};

}  // namespace

std::string view_fragment(const Viewpoint& from) {
  // As web/src/camera/rig.ts turns them.
  const glm::vec3 backward = from.eye - from.target;
  const float distance = glm::length(backward);
  if (!(distance > 0)) throw std::runtime_error("--eye and --target are one point");
  const float yaw = std::atan2(backward.z, backward.x), pitch = std::asin(backward.y / distance);
  return fmt::format("view={:g},{:g},{:g},{:g},{:g},{:g}", from.target.x, from.target.y, from.target.z, yaw, pitch,
                     distance);
}

int view_in_page(splats::SplatFile file, const PageOptions& options) {
  if (file.gaussians.count() == 0) throw std::runtime_error(options.path + ": no Gaussians to show");
  require_page();
  Launch launch = launch_of(file, options);
  if (options.from) launch.gateway.url += "/#" + view_fragment(*options.from);

  const StopSignals signals;
  const PrivateBusFolder folder;
  const LaunchPlan plan = plan_launch(launch.file, folder.address(), program_directory());
  check_parameters(launch.file, plan);
  SupervisedRun run(plan, {});
  const StillPublisher model(connect_later(folder.address()), file.gaussians.view());
  file.gaussians = GaussiansBuffer();  // it is in the slabs now
  model.publish(options.background);
  bool invited = false;
  for (; !signals.stop().stop_requested(); std::this_thread::sleep_for(kTurn)) {
    run.check();
    if (invited || !run.all_running()) continue;
    fmt::print("{}: {} Gaussians\n", options.path, model.count());
    fmt::print("{}; Ctrl-C ends it\n", invitation(launch.gateway));
    std::fflush(stdout);
    invited = true;
  }
  return 0;
}

}  // namespace splatbus::cli
