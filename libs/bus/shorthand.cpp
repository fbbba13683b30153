#include "bus/shorthand.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdlib>
#include <string_view>

namespace splatbus::bus {
namespace {

constexpr std::string_view kBackend = "--backend ";
constexpr const char* kVariable = "SPLATBUS_BACKEND";
const std::vector<std::string> kDevices{"cpu", "cuda", "auto"};

}  // namespace

void add_backend_and_shorthands(CLI::App& app, const std::vector<Shorthand>& flags, std::string& backend,
                                std::vector<std::string>& settings) {
  std::vector<std::string> known = kDevices;
  std::string help = "device to compute on: cpu, cuda or auto";
  for (const Shorthand& one : flags) {
    if (!one.flag.starts_with(kBackend)) continue;
    known.push_back(one.flag.substr(kBackend.size()));
    help += fmt::format("; {}: {}", known.back(), one.help);
  }
  // One that is given for a shorthand alone leaves the device at what the variable says.
  const char* const variable = std::getenv(kVariable);
  if (variable != nullptr && std::ranges::count(kDevices, variable) > 0) backend = variable;
  app.add_option_function<std::vector<std::string>>(
         "--backend",
         [&](const std::vector<std::string>& given) {
           for (const std::string& name : given) {
             const auto own = std::ranges::find(flags, std::string(kBackend) + name, &Shorthand::flag);
             if (own != flags.end()) settings.push_back(own->setting);
             if (own == flags.end()) backend = name;
           }
         },
         help)
      ->envname(kVariable)
      ->allow_extra_args(false)
      ->check(CLI::IsMember(known))
      ->default_str("auto");
  for (const Shorthand& one : flags) {
    if (one.flag.starts_with(kBackend)) continue;
    const auto take = [&settings, &one](const std::string& value) { settings.push_back(one.setting + value); };
    CLI::Option* const option = one.setting.ends_with('=')
                                    ? app.add_option_function<std::string>(one.flag, take, one.help)
                                    : app.add_flag_callback(
                                          one.flag, [take] { take(""); }, one.help);
    option->multi_option_policy(CLI::MultiOptionPolicy::TakeLast);
  }
}

}  // namespace splatbus::bus
