#include <CLI/CLI.hpp>
#include <memory>
#include <string>
#include <tuple>

#include "topic_verbs.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

CLI::App* add_verb(CLI::App& parent, const std::string& name, const std::string& text,
                   const std::shared_ptr<TopicOptions>& options, const std::string& seconds_text) {
  CLI::App* verb = parent.add_subcommand(name, text);
  verb->add_option("--seconds", options->seconds, seconds_text)->check(CLI::NonNegativeNumber);
  verb->add_flag("--json", options->json, "one JSON object a line");
  add_bus_option(*verb, options->bus);
  return verb;
}

}  // namespace

void add_topic_verb(CLI::App& app, Action& action) {
  CLI::App* topic = app.add_subcommand("topic", "Look at what crosses the bus");
  topic->require_subcommand(1);
  constexpr const char* kForever = "how long; 0: until Ctrl-C";
  constexpr const char* kTopics = "topics; a name that ends in * is a prefix (default: all)";

  auto list_options = std::make_shared<TopicOptions>();
  list_options->seconds = 2;
  CLI::App* list_verb = add_verb(*topic, "list", "Topics since the broker started, with schema, source and rate",
                                 list_options, "how long to listen (default 2)");
  list_verb->callback([list_options, &action] { action = [list_options] { return list_topics(*list_options); }; });

  auto echo_options = std::make_shared<TopicOptions>();
  CLI::App* echo_verb = add_verb(*topic, "echo", "Print messages as JSON, tensors summarised", echo_options, kForever);
  echo_verb->add_option("topic", echo_options->topics, kTopics);
  echo_verb->add_option("-n,--count", echo_options->count, "stop after that many messages; 0: no limit");
  echo_verb->callback([echo_options, &action] { action = [echo_options] { return echo_topics(*echo_options); }; });

  echo_verb->add_flag("--once", echo_options->once, "print one message and exit");
  echo_verb->add_option("--field", echo_options->fields,
                        "print this field alone, as scene.light.generation; repeatable");
  echo_verb->add_option(
      "--filter", echo_options->filter,
      "print messages for which this holds: FIELD OP VALUE, joined by &&; OP is ==, !=, <, <=, > or >=");
  echo_verb->add_flag("--csv", echo_options->csv, "print the fields as CSV with a header line");

  const std::tuple<const char*, const char*, Meter> meters[] = {
      {"hz", "Measure rates and intervals once a second; silent topics are named", Meter::Rate},
      {"bw", "Measure bandwidth once a second, sockets and shared memory apart", Meter::Bandwidth},
      {"delay", "Measure how old messages are when they reach the bus", Meter::Delay}};
  for (const auto& [name, text, kind] : meters) {
    auto options = std::make_shared<TopicOptions>();
    CLI::App* verb = add_verb(*topic, name, text, options, kForever);
    verb->add_option("topic", options->topics, kTopics);
    verb->callback(
        [options, kind = kind, &action] { action = [options, kind] { return meter_topics(*options, kind); }; });
  }

  auto info_options = std::make_shared<TopicOptions>();
  CLI::App* info_verb = topic->add_subcommand("info", "Show schema, publishers and subscribers of topics");
  info_verb->add_option("topic", info_options->topics, kTopics);
  info_verb->add_flag("--json", info_options->json, "one JSON object a line");
  add_bus_option(*info_verb, info_options->bus);
  info_verb->callback([info_options, &action] { action = [info_options] { return describe_topics(*info_options); }; });

  auto graph_options = std::make_shared<TopicOptions>();
  auto dot = std::make_shared<bool>(false);
  CLI::App* graph_verb = app.add_subcommand("graph", "Show who publishes and who reads each topic");
  graph_verb->add_option("topic", graph_options->topics, kTopics);
  CLI::Option* const as_dot = graph_verb->add_flag("--dot", *dot, "print the graph in the DOT language of Graphviz");
  graph_verb->add_flag("--json", graph_options->json, "one JSON object a line")->excludes(as_dot);
  add_bus_option(*graph_verb, graph_options->bus);
  graph_verb->callback(
      [graph_options, dot, &action] { action = [graph_options, dot] { return graph_topics(*graph_options, *dot); }; });
}

}  // namespace splatbus::cli
