#include "bus/shorthand.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <string_view>

namespace splatbus::bus {
namespace {

constexpr std::string_view kBackend = "--backend ";

}  // namespace

void add_backend_and_shorthands(CLI::App& app, const std::vector<Shorthand>& flags, std::string& backend,
                                std::vector<std::string>& changes) {
  std::vector<std::string> devices{"cpu", "cuda", "auto"};
  std::string help = "device to compute on: cpu, cuda or auto";
  for (const Shorthand& one : flags) {
    if (!one.flag.starts_with(kBackend)) continue;
    devices.push_back(one.flag.substr(kBackend.size()));
    help += fmt::format("; {}: {}", devices.back(), one.help);
  }
  app.add_option_function<std::string>(
         "--backend",
         [&](const std::string& given) {
           const auto own = std::ranges::find_if(flags, [&](const Shorthand& one) {
             return one.flag.starts_with(kBackend) && one.flag.substr(kBackend.size()) == given;
           });
           if (own != flags.end()) changes.push_back(own->setting);
           backend = own != flags.end() ? "auto" : given;
         },
         help)
      ->envname("SPLATBUS_BACKEND")
      ->check(CLI::IsMember(devices))
      ->default_str(backend);
  for (const Shorthand& one : flags) {
    if (one.flag.starts_with(kBackend)) continue;
    const auto take = [&changes, &one](const std::string& value) { changes.push_back(one.setting + value); };
    if (one.setting.ends_with('=')) {
      app.add_option_function<std::string>(one.flag, take, one.help);
    } else {
      app.add_flag_callback(one.flag, [take] { take(""); }, one.help);
    }
  }
}

}  // namespace splatbus::bus
