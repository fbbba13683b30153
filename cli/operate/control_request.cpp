#include "control_request.h"

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <chrono>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <utility>

#include "control_socket.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;

Json ask(LineSocket& socket, Json request, const std::function<void(const std::string&)>& progress) {
  request["version"] = kControlVersion;
  if (!socket.send(request)) throw std::runtime_error("the supervisor has just gone");
  while (auto answer = socket.receive()) {
    if (answer->contains("progress")) {
      if (progress) progress(answer->value("progress", ""));
    } else if (answer->value("ok", false)) {
      return std::move(*answer);
    } else {
      throw std::runtime_error(answer->value("error", "the supervisor refused"));
    }
  }
  throw std::runtime_error("the supervisor went before it answered");
}

}  // namespace

Json ask_supervisor(const bus::Address& bus, Json request, const std::function<void(const std::string&)>& progress) {
  LineSocket socket = connect_control(bus);
  return ask(socket, std::move(request), progress);
}

void stop_supervisor(const bus::Address& bus) {
  LineSocket socket = connect_control(bus);
  static_cast<void>(ask(socket, {{"verb", "down"}}, {}));
  while (socket.receive()) {
  }
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
