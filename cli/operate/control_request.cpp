#include "control_request.h"

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <utility>

#include "control_socket.h"
#include "swap.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;

/// For how long a supervisor that works may be silent: each step of a verb takes what the request allows at most, and
/// is told before. A swap has steps with limits of their own.
double longest_step_s(const Json& request) {
  const double wait_s = request.value("wait_s", 0.0);
  if (request.value("verb", "") != "swap") return wait_s;
  const SwapLimits limits;
  return std::max({wait_s, limits.yield_s, limits.take_over_s});
}

Json ask(LineSocket& socket, Json request, const std::function<void(const std::string&)>& progress,
         double answer_within_s) {
  request["version"] = kControlVersion;
  socket.set_patience(longest_step_s(request) + answer_within_s);
  if (!socket.send(request)) throw std::runtime_error("the supervisor has just ended");
  while (auto answer = socket.receive()) {
    if (answer->contains("progress")) {
      if (progress) progress(answer->value("progress", ""));
    } else if (answer->value("ok", false)) {
      return std::move(*answer);
    } else {
      throw std::runtime_error(answer->value("error", "the supervisor refused"));
    }
  }
  throw std::runtime_error("the supervisor ended before it answered");
}

/// "; still there: a, b", or nothing where that cannot be said.
std::string what_still_runs(const bus::Address& bus) {
  std::string names;
  try {
    const Json answer = ask_supervisor(bus, {{"verb", "status"}});
    for (const Json& process : answer.at("services")) {
      if (process.contains("pid")) names += fmt::format("{}{}", names.empty() ? "" : ", ", process.value("name", ""));
    }
  } catch (const std::exception&) {  // it may be gone by now
  }
  return names.empty() ? names : fmt::format("; still there: {}", names);
}

}  // namespace

Json ask_supervisor(const bus::Address& bus, Json request, const std::function<void(const std::string&)>& progress,
                    double answer_within_s) {
  LineSocket socket = connect_control(bus);
  return ask(socket, std::move(request), progress, answer_within_s);
}

double stop_patience_s(const Json& answer) {
  constexpr double kUsualS = 60, kSlackS = 10;
  return std::max(kUsualS, answer.value("stops_within_s", 0.0) + kSlackS);
}

Json stop_supervisor(const bus::Address& bus, std::optional<double> asked_wait_s) {
  LineSocket socket = connect_control(bus);
  Json answer = ask(socket, {{"verb", "down"}}, {}, kAnswerWithinS);
  constexpr double kAtOnceS = 0.001;  // 0 would be for ever
  const double wait_s = asked_wait_s.value_or(stop_patience_s(answer));
  socket.set_patience(std::max(wait_s, kAtOnceS));
  try {
    while (socket.receive()) {
    }
  } catch (const SupervisorSilent&) {
    throw std::runtime_error(fmt::format("not everything has ended within {:.3g} s{}", wait_s, what_still_runs(bus)));
  }
  return answer;
}

std::string event_json(const OutputLine& line) {
  const auto now = std::chrono::time_point_cast<std::chrono::milliseconds>(std::chrono::system_clock::now());
  const auto ms = now.time_since_epoch().count() % 1000;
  Json json{
      {"time", fmt::format("{:%Y-%m-%dT%H:%M:%S}.{:03}Z", fmt::gmtime(std::chrono::system_clock::to_time_t(now)), ms)},
      {"service", line.process}};
  if (line.event.empty()) {
    json["line"] = line.text;
  } else {
    json["event"] = line.event;
    json["text"] = line.text;
    if (line.pid != 0) json["pid"] = line.pid;
    if (line.exit && line.exit->signal != 0) json["signal"] = line.exit->signal;
    if (line.exit && line.exit->signal == 0) json["status"] = line.exit->code;
    if (line.restart_in_s) json["restart_in_s"] = *line.restart_in_s;
  }
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace splatbus::cli
