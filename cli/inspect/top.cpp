#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <map>
#include <memory>
#include <stdexcept>

#include "schema_json.h"
#include "supervised_run.h"
#include "top_screen.h"
#include "top_table.h"
#include "topic_watch.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

constexpr double kFirstViewPatienceS = 10;
constexpr std::chrono::milliseconds kKeyPatience(50);

struct TopOptions {
  std::string bus, sort = "name";
  double seconds = 0;
  bool once = false, json = false;
};

const std::map<std::string, TopOrder> kOrders{{"name", TopOrder::Name},
                                              {"cpu", TopOrder::Processor},
                                              {"memory", TopOrder::Memory},
                                              {"rate", TopOrder::Rate},
                                              {"drops", TopOrder::Drops}};
/// Keys are the first letters of the names.
std::string foot(TopOrder order) {
  std::string name;
  for (const auto& [text, value] : kOrders) {
    if (value == order) name = text;
  }
  return fmt::format(" sorted by {:<7}| n name  c cpu  m memory  r rate  d drops | arrows scroll | q quit ", name);
}

/// Waits until there are rates and loads, which are differences of two views. False when a stop was asked for.
bool warm_up(TopSampler& sampler, const StopSignals& signals) {
  const Deadline deadline(kFirstViewPatienceS);
  for (bool viewed = false; !sampler.complete();) {
    if (signals.stop().stop_requested()) return false;
    if (deadline.passed()) {
      throw std::runtime_error(fmt::format("the bus has said nothing of its topics for {} s", kFirstViewPatienceS));
    }
    sampler.follow(kPatience);
    if (viewed || !sampler.started()) continue;
    static_cast<void>(sampler.view());
    viewed = true;
  }
  return true;
}

void print_view(TopSampler& sampler, const TopOptions& options, TopOrder order) {
  TopView view = sampler.view();
  sort_services(view, order);
  if (options.json) {
    print(json_text(to_json(view)));
    return;
  }
  for (const std::string& line : top_lines(view)) print(line);
}

int show(TopSampler& sampler, const TopOptions& options, TopOrder order, const StopSignals& signals) {
  TopScreen screen;
  screen.draw({"waiting for the bus ..."}, foot(order));
  TopView view;
  std::int64_t shown_ns = 0;  // published_ns of nothing yet
  const Deadline deadline(options.seconds);
  while (!signals.stop().stop_requested() && !deadline.passed()) {
    sampler.follow(kKeyPatience);
    bool changed = false;
    while (const auto key = screen.key()) {
      if (*key == 'q') return 0;
      for (const auto& [name, value] : kOrders) {
        if (name[0] == *key) order = value, changed = true;
      }
    }
    constexpr std::int64_t kPeriodNs = 1'000'000'000;
    if (bus::now_ns() - shown_ns >= kPeriodNs) {
      view = sampler.view();
      shown_ns = bus::now_ns();
      changed = true;
    }
    if (!changed) continue;
    sort_services(view, order);
    screen.draw(top_lines(view), foot(order));
  }
  return 0;
}

int top(const TopOptions& options) {
  const StopSignals signals;
  const bus::Address address = bus_address(options.bus);
  TopSampler sampler(connect(address), address);
  const TopOrder order = kOrders.at(options.sort);
  if (!options.once && !options.json) return show(sampler, options, order, signals);
  const Deadline deadline(options.seconds);
  if (!warm_up(sampler, signals)) return 1;
  do {
    print_view(sampler, options, order);
    if (options.once) return 0;
    for (const Deadline second(1); !second.passed() && !signals.stop().stop_requested();) sampler.follow(kPatience);
  } while (!signals.stop().stop_requested() && !deadline.passed());
  return 0;
}

}  // namespace

void add_top_verb(CLI::App& app, Action& action) {
  auto options = std::make_shared<TopOptions>();
  CLI::App* verb = app.add_subcommand("top", "Watch services and topics: load, memory, rates, drops and latency");
  verb->add_flag("--once", options->once, "print one table and exit");
  verb->add_flag("--json", options->json, "print one JSON object a second; with --once, one");
  verb->add_option("--sort", options->sort, "sort services by name, cpu, memory, rate or drops")
      ->check(CLI::IsMember({"name", "cpu", "memory", "rate", "drops"}));
  verb->add_option("--seconds", options->seconds, "how long; 0: until q or Ctrl-C")->check(CLI::NonNegativeNumber);
  add_bus_option(*verb, options->bus);
  verb->callback([options, &action] { action = [options] { return top(*options); }; });
}

}  // namespace splatbus::cli
