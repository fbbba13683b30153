#include "engine_scene.h"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>

namespace splatbus::cli {

void set_flag(std::vector<std::string>& args, const std::string& flag, const std::string& value) {
  const auto found = std::ranges::find(args, flag);
  if (found != args.end()) args.erase(found, found + std::min<std::ptrdiff_t>(2, args.end() - found));
  args.insert(args.end(), {flag, value});
}

void apply(const EngineScene& scene, LaunchFile& file) {
  LaunchService* engine = file.find("engine");
  if (engine == nullptr) throw LaunchError({file.path, 0, 0}, "there is no service 'engine'");
  // The engine's flags are its own.
  std::vector<std::string>& args = engine->args;
  if (scene.fps) set_flag(args, "--fps", fmt::format("{}", *scene.fps));
  set_flag(args, "--sun-rate", fmt::format("{}", scene.sun_rate_deg_s));
  set_flag(args, "--point-lights", std::to_string(scene.point_lights));
  std::erase(args, "--night");
  if (scene.point_lights > 0) args.emplace_back("--night");
  std::erase(args, "--dynamics");
  if (scene.moving_objects) args.emplace_back("--dynamics");
  apply_override(file, fmt::format("capture-bridge.reference_rate_hz={}", scene.reference_rate_hz));
}

}  // namespace splatbus::cli
