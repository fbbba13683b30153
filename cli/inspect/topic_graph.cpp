#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cstdio>
#include <nlohmann/json.hpp>
#include <vector>

#include "schema_json.h"
#include "topic_verbs.h"

namespace splatbus::cli {

int describe_topics(const TopicOptions& options) {
  const TopicSnapshot now = topics_now(options.bus);
  bool found = false;
  for (const auto& [topic, seen] : now.topics) {
    if (!is_asked_for(options, topic)) continue;
    found = true;
    if (options.json) {
      print(json_text({{"topic", topic},
                       {"schemas", seen.schemas},
                       {"publishers", seen.sources},
                       {"subscribers", seen.subscribers},
                       {"latched", seen.latched},
                       {"messages", seen.messages},
                       {"bytes", seen.bytes},
                       {"shared_bytes", seen.shared_bytes}}));
      continue;
    }
    print(fmt::format(
        "{}\n  schema       {}\n  publishers   {}\n  subscribers  {}\n  latched      {}\n"
        "  messages     {}, {} bytes on sockets and {} in shared memory",
        topic, fmt::join(seen.schemas, ", "), fmt::join(seen.sources, ", "), fmt::join(seen.subscribers, ", "),
        seen.latched ? "yes" : "no", seen.messages, seen.bytes - seen.shared_bytes, seen.shared_bytes));
  }
  std::vector<std::string> there;
  for (const auto& [topic, seen] : now.topics) there.push_back(topic);
  name_absent("info", options, there);
  return found ? 0 : 1;
}

std::string graph_text(const TopicOptions& options, const TopicSnapshot& now, bool dot) {
  // Json(text).dump() quotes as DOT does.
  const auto quoted = [](const std::string& text) { return json_text(nlohmann::json(text)); };
  std::string text;
  if (dot) text += "digraph splatbus {\n  rankdir=LR;\n";
  for (const auto& [topic, seen] : now.topics) {
    if (!is_asked_for(options, topic)) continue;
    if (!dot) {
      text += fmt::format("{} -> {} -> {}\n", fmt::join(seen.sources, ", "), topic,
                          seen.subscribers.empty() ? "nobody" : fmt::format("{}", fmt::join(seen.subscribers, ", ")));
      continue;
    }
    const std::string box = quoted("/" + topic);
    text += fmt::format("  {} [shape=box];\n", box);
    for (const auto& source : seen.sources) text += fmt::format("  {} -> {};\n", quoted(source), box);
    for (const auto& reader : seen.subscribers) text += fmt::format("  {} -> {};\n", box, quoted(reader));
  }
  if (dot) text += "}\n";
  return text;
}

int graph_topics(const TopicOptions& options, bool dot) {
  const TopicSnapshot now = topics_now(options.bus);
  if (!options.json) {
    fmt::print("{}", graph_text(options, now, dot));
    return 0;
  }
  for (const auto& [topic, seen] : now.topics) {
    if (!is_asked_for(options, topic)) continue;
    print(json_text({{"topic", topic}, {"publishers", seen.sources}, {"subscribers", seen.subscribers}}));
  }
  return 0;
}

}  // namespace splatbus::cli
