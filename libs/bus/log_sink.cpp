#include "bus/log_sink.h"

#include <fmt/format.h>
#include <spdlog/sinks/base_sink.h>
#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <mutex>
#include <utility>

#include "bus/command_line.h"
#include "bus/error.h"
#include "bus/publisher.h"
#include "wire/system_generated.h"

namespace splatbus::bus {
namespace {

constexpr std::size_t max_text = 4096;

wire::LogLevel to_wire(spdlog::level::level_enum level) {
  if (level <= spdlog::level::debug) return wire::LogLevel::Debug;
  if (level == spdlog::level::info) return wire::LogLevel::Info;
  return level == spdlog::level::warn ? wire::LogLevel::Warning : wire::LogLevel::Error;
}

class BusSink final : public spdlog::sinks::base_sink<std::mutex> {
 public:
  explicit BusSink(std::shared_ptr<Context> context) : publisher_(std::move(context)) {}

 private:
  void sink_it_(const spdlog::details::log_msg& line) override {
    const std::string text(line.payload.data(), std::min(line.payload.size(), max_text));
    publisher_.publish(topics::kLog, [&](auto& builder, auto header) {
      return wire::CreateLogDirect(builder, header, to_wire(line.level), text.c_str());
    });
  }
  void flush_() override {}

  Publisher publisher_;
};

void install(std::vector<spdlog::sink_ptr> sinks, const std::string& name, spdlog::level::level_enum level) {
  auto logger = std::make_shared<spdlog::logger>(name, sinks.begin(), sinks.end());
  logger->set_level(level);
  logger->flush_on(spdlog::level::trace);
  spdlog::set_default_logger(std::move(logger));
}

spdlog::sink_ptr make_stderr_sink() {
  auto sink = std::make_shared<spdlog::sinks::stderr_sink_mt>();
  // A supervisor writes time and name itself.
  sink->set_pattern(is_supervised() ? "[%l] %v" : "[%H:%M:%S.%e] [%n] [%l] %v");
  return sink;
}

spdlog::level::level_enum parse_level(const std::string& text) {
  const auto level = spdlog::level::from_str(text);
  if (level == spdlog::level::off && text != "off") throw Error(fmt::format("log level '{}' does not exist", text));
  return level;
}

}  // namespace

void log_to_stderr(const std::string& name, const std::string& level) {
  install({make_stderr_sink()}, name, parse_level(level));
}

void install_logger(const std::shared_ptr<Context>& context, const std::string& level) {
  const auto parsed = parse_level(level);
  auto bus_sink = std::make_shared<BusSink>(context);
  bus_sink->set_level(spdlog::level::info);
  install({make_stderr_sink(), std::move(bus_sink)}, context->source(), parsed);
}

void uninstall_logger() {
  const auto before = spdlog::default_logger();
  install({make_stderr_sink()}, before->name(), before->level());
}

}  // namespace splatbus::bus
