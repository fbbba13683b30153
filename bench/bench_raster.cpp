// Time of rendering and of training steps on one scene and a ring of cameras, stage by stage, beside the least time
// that each stage can take on this machine.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <fstream>
#include <stdexcept>

#include "bench/bench_scene.h"
#include "bench/roofline.h"
#include "fmt/core.h"

namespace {

nlohmann::json run(const splatbus::bench::Arguments& arguments) {
  if (arguments.backend == "cpu") return splatbus::bench::run_cpu(arguments);
#ifdef SPLATBUS_BENCH_CUDA
  return splatbus::bench::run_cuda(arguments);
#else
  throw std::runtime_error("built without CUDA");
#endif
}

}  // namespace

int main(int argc, char** argv) {
  splatbus::bench::Arguments arguments;
  CLI::App app("Times the rasteriser on a PLY scene and a cameras file.");
  app.add_option("--scene", arguments.scene, "PLY in the 3DGS layout")->required();
  app.add_option("--cams", arguments.cameras, "JSON: width, height, world_to_camera, intrinsics")->required();
  app.add_option("--backend", arguments.backend)->check(CLI::IsMember({"cpu", "cuda"}));
  app.add_option("--mode", arguments.mode)->check(CLI::IsMember({"forward", "train"}));
  app.add_option("--appearance", arguments.appearance)->check(CLI::IsMember({"radiance", "transfer"}));
  app.add_option("--sh", arguments.sh, "SH degree of radiance")->check(CLI::Range(0, 3));
  app.add_option("--active-channels", arguments.active_channels, "channels trained, 0: all")->check(CLI::Range(0, 59));
  app.add_option("--batch", arguments.batch, "views a step")->check(CLI::Range(1, 64));
  app.add_option("--threads", arguments.threads, "0: all cores")->check(CLI::Range(0, 1024));
  app.add_option("--iterations", arguments.iterations, "timed steps")->check(CLI::Range(1, 1000000));
  app.add_option("--warmup", arguments.warmup, "steps before them")->check(CLI::Range(0, 100000));
  app.add_option("--albedo-weight", arguments.albedo_weight, "CUDA, transfer: of an albedo picture's loss, 0: none")
      ->check(CLI::Range(0.0F, 100.0F));
  app.add_flag("--separate-adam", arguments.separate_adam, "backward and Adam as two passes even at a batch of 1");
  app.add_option("--pages", arguments.pages, "none; all: pages, every one listed; seen: pages that a camera sees")
      ->check(CLI::IsMember({"none", "all", "seen"}));
  app.add_option("--sources", arguments.sources, "transfer: light sources besides the sun, each with visibility")
      ->check(CLI::Range(std::size_t{0}, splatbus::kMaxLightSources));
  app.add_option("--copies", arguments.copies, "of the scene, of which the cameras see one")
      ->check(CLI::Range(1, 1000));
  app.add_option("--json", arguments.json, "where the result goes; standard output if absent");
  CLI11_PARSE(app, argc, argv);
  try {
    const nlohmann::json result = run(arguments);
    const std::string text = result.dump(2);
    fmt::print(stderr, "{}", splatbus::bench::roofline_table(result));
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
