#include "bus/rights.h"

#include <array>
#include <utility>

namespace splatbus::bus {
namespace {

constexpr std::array<std::pair<std::string_view, bool Rights::*>, 4> roles{
    {{"view", &Rights::view}, {"steer", &Rights::steer}, {"probe", &Rights::probe}, {"control", &Rights::control}}};

}  // namespace

std::string to_text(const Rights& rights) {
  std::string text;
  for (const auto& [name, member] : roles) {
    if (!(rights.*member)) continue;
    if (!text.empty()) text += ',';
    text += name;
  }
  return text;
}

std::optional<Rights> parse_rights(std::string_view text) {
  Rights rights;
  while (!text.empty()) {
    const auto comma = text.find(',');
    const auto name = text.substr(0, comma);
    text = comma == std::string_view::npos ? std::string_view() : text.substr(comma + 1);
    bool known = false;
    for (const auto& [role, member] : roles) {
      if (name != role) continue;
      rights.*member = true;
      known = true;
    }
    if (!known) return std::nullopt;
  }
  return rights;
}

}  // namespace splatbus::bus
