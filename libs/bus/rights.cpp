#include "bus/rights.h"

#include <array>
#include <utility>

namespace splatbus::bus {
namespace {

constexpr std::array<std::pair<std::string_view, bool Rights::*>, 4> roles{
    {{"view", &Rights::view}, {"steer", &Rights::steer}, {"probe", &Rights::probe}, {"control", &Rights::control}}};
constexpr std::string_view relayed = "rights ";  // as a FlatBuffer's root it would lie 1.6 GiB away

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

std::string rights_frame(const Rights& rights) {
  return std::string(relayed) + to_text(rights);
}

std::optional<Rights> parse_rights_frame(std::string_view frame) {
  if (!frame.starts_with(relayed)) return std::nullopt;
  return parse_rights(frame.substr(relayed.size())).value_or(Rights());
}

}  // namespace splatbus::bus
