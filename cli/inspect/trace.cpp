#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <memory>
#include <set>
#include <stdexcept>
#include <system_error>

#include "bus/publisher.h"
#include "bus/subscriber.h"
#include "schema_json.h"
#include "supervised_run.h"
#include "topic_watch.h"
#include "trace_events.h"
#include "verbs.h"
#include "wire/trace_generated.h"
#include "wire/trace_topics.h"

namespace splatbus::cli {

namespace {

constexpr double kAgainS = 1;       // requests count for 3 s, and are repeated for whoever comes later
constexpr double kLastBeatS = 0.5;  // until what was recorded at the end is here
constexpr std::size_t kMaxSpans = 2'000'000;

struct TraceOptions {
  std::string bus, out = "trace.json";
  double seconds = 5;
};

void ask(const bus::Publisher& publisher, double seconds) {
  publisher.publish(topics::kTraceRequest, [&](auto& builder, auto header) {
    return wire::CreateTraceRequest(builder, header, bus::now_ns() + static_cast<std::int64_t>(seconds * 1e9));
  });
}

struct Collected {
  std::vector<TracedSpan> spans;
  std::uint64_t lost = 0;
};

void take(const wire::Spans& message, Collected& collected) {
  collected.lost += message.lost();
  if (message.spans() == nullptr) return;
  for (const wire::WorkSpan* span : *message.spans()) {
    if (collected.spans.size() >= kMaxSpans) {
      ++collected.lost;
      continue;
    }
    collected.spans.push_back({.source = message.header()->source()->str(),
                               .name = span->name()->str(),
                               .pid = message.pid(),
                               .thread = span->thread(),
                               .begin_ns = span->begin_ns(),
                               .end_ns = std::max(span->begin_ns(), span->end_ns()),
                               .capture_ns = span->capture_ns(),
                               .scene_version = span->scene_version()});
  }
}

std::shared_ptr<bus::Context> connect_here(const TraceOptions& options) {
  const bus::Address address = bus_address(options.bus);
  if (!address.is_local()) {
    throw std::runtime_error(
        "the clocks of different machines cannot be compared: run trace on the machine of the bus");
  }
  return connect(address);
}

Collected collect(const TraceOptions& options, const std::shared_ptr<bus::Context>& context,
                  const StopSignals& signals) {
  const bus::Publisher publisher(context);
  bus::Subscriber subscriber(context);
  Collected collected;
  subscriber.on(topics::kSpans, [&](const wire::Spans& message, const bus::Message&) { take(message, collected); });
  if (!subscriber.wait_connected(std::chrono::seconds(5)) || !context->wait_connected(std::chrono::seconds(5))) {
    throw std::runtime_error("the bus has not answered for 5 s");
  }
  for (const Deadline all(options.seconds); !all.passed() && !signals.stop().stop_requested();) {
    ask(publisher, 3 * kAgainS);
    for (const Deadline turn(kAgainS); !turn.passed() && !all.passed() && !signals.stop().stop_requested();) {
      subscriber.dispatch_all(kPatience);
    }
  }
  ask(publisher, 0);
  for (const Deadline last(kLastBeatS); !last.passed();) subscriber.dispatch_all(kPatience);
  return collected;
}

/// The way of the frame that went through most processes, the earliest of those: what a user looks for first.
void print_way(const std::vector<TracedSpan>& spans) {
  const auto ways = ways_of_frames(spans);
  const auto processes = [](const auto& way) {
    std::set<std::uint32_t> pids;
    for (const TracedSpan* span : way.second) pids.insert(span->pid);
    return pids.size();
  };
  const auto longest = std::max_element(ways.begin(), ways.end(),
                                        [&](const auto& a, const auto& b) { return processes(a) < processes(b); });
  if (longest == ways.end()) return;
  print(fmt::format("{:>10} {:>10}  {:<18} {}", "AFTER ms", "TOOK ms", "PROCESS", "WORK"));
  for (const TracedSpan* span : longest->second) {
    print(fmt::format("{:>10.2f} {:>10.2f}  {:<18} {}", static_cast<double>(span->begin_ns - longest->first) / 1e6,
                      static_cast<double>(span->end_ns - span->begin_ns) / 1e6, span->source, span->name));
  }
}

/// Asked before the time is spent. What the file holds stays until there is something newer, and none is left behind
/// where there was none.
void require_writable(const std::string& path) {
  std::error_code ignored;
  const bool is_new = !std::filesystem::exists(path, ignored);
  if (!std::ofstream(path, std::ios::app)) throw std::runtime_error(fmt::format("cannot write {}", path));
  if (is_new) std::filesystem::remove(path, ignored);
}

int trace(const TraceOptions& options) {
  const StopSignals signals;
  const auto context = connect_here(options);
  require_writable(options.out);
  Collected collected = collect(options, context, signals);
  if (collected.spans.empty()) throw std::runtime_error("nothing was traced: no process reported its work");
  assign_frames(collected.spans);
  std::ofstream file(options.out, std::ios::trunc);
  file << json_text(trace_events(collected.spans)) << '\n';
  file.close();
  if (!file) throw std::runtime_error(fmt::format("cannot write all of {}", options.out));
  std::set<std::string> sources;
  for (const TracedSpan& span : collected.spans) sources.insert(span.source);
  print_way(collected.spans);
  print(fmt::format("{}: {} spans of {} processes{}; open it at https://ui.perfetto.dev", options.out,
                    collected.spans.size(), sources.size(),
                    collected.lost > 0 ? fmt::format(", {} lost", collected.lost) : ""));
  return 0;
}

}  // namespace

void add_trace_verb(CLI::App& app, Action& action) {
  auto options = std::make_shared<TraceOptions>();
  CLI::App* verb = app.add_subcommand("trace", "Record each engine frame's way through all processes, for Perfetto");
  verb->add_option("--seconds", options->seconds, "how long, s (default 5)")->check(CLI::Range(0.1, 600.0));
  verb->add_option("-o,--out", options->out, "trace file, Chrome's JSON format (default trace.json)");
  add_bus_option(*verb, options->bus);
  verb->callback([options, &action] { action = [options] { return trace(*options); }; });
}

}  // namespace splatbus::cli
