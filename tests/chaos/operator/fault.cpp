#include "fault.h"

#include <signal.h>

#include <array>

namespace splatbus::chaos {
namespace {

constexpr std::array kSwapped{"trainer", "trainer",        "trainer",  "expander", "relight",
                              "bus",     "capture-bridge", "streamer", "gateway",  "viewer"};
constexpr std::array kKilled{"bus",     "engine",   "capture-bridge", "expander", "trainer",
                             "relight", "streamer", "viewer",         "gateway"};

struct Setting {
  const char* service;
  const char* key;
  std::array<const char*, 2> values;
};

constexpr std::array<Setting, 6> kSettings{{{"trainer", "ssim_weight", {"0.2", "0.3"}},
                                            {"trainer", "prune_interval", {"100", "200"}},
                                            {"relight", "newest_rate_hz", {"5", "10"}},
                                            {"streamer", "visibility_hz", {"10", "20"}},
                                            {"capture-bridge", "input_deadline_s", {"1", "2"}},
                                            {"expander", "resend_s", {"1", "2"}}}};

}  // namespace

std::string OperatorFault::name() const {
  std::string text;
  for (const std::string& word : verb) text += (text.empty() ? "" : " ") + word;
  if (killed.empty()) return text;
  if (!text.empty()) text += ", " + std::to_string(after.count()) + " ms later ";
  return text + (signal == SIGKILL ? "kill " : "terminate ") + killed;
}

std::vector<std::string> OperatorFaults::swap() {
  const std::string name = kSwapped[below(kSwapped.size())];
  if (name == "trainer" && below(2) == 0) return {"swap", name, "--set", below(2) == 0 ? "batch=1" : "batch=2"};
  return {"swap", name};
}

std::vector<std::string> OperatorFaults::parameter() {
  const Setting& setting = kSettings[below(kSettings.size())];
  return {"param", "set", setting.service, setting.key, setting.values[below(2)]};
}

OperatorFault OperatorFaults::next() {
  OperatorFault fault;
  const std::size_t kind = below(21);
  if (kind < 6) {
    fault.verb = swap();
  } else if (kind < 9) {
    fault.verb = {"scale", std::string(below(2) == 0 ? "streamer=" : "relight=") + (below(2) == 0 ? "1" : "2")};
  } else if (kind < 12) {
    fault.verb = {"restart", kKilled[below(kKilled.size())]};
  } else if (kind < 14) {
    fault.verb = parameter();
  } else if (kind < 17) {
    fault.killed = kKilled[below(kKilled.size())];
  } else if (kind == 17) {
    fault.verb = {"status"};  // to know what pictures do when nothing happens
  } else {
    fault.verb = swap();
    fault.killed = fault.verb[1] + (below(2) == 0 ? ".next" : "");
    fault.after = std::chrono::milliseconds(below(1500));
  }
  if (!fault.killed.empty()) fault.signal = below(3) == 0 ? SIGTERM : SIGKILL;
  return fault;
}

std::chrono::milliseconds OperatorFaults::pause() {
  return std::chrono::milliseconds(500 + below(2500));
}

}  // namespace splatbus::chaos
