#include <fmt/format.h>
#include <fmt/ranges.h>

#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>

#include "message_filter.h"
#include "schema_json.h"
#include "supervised_run.h"
#include "topic_verbs.h"
#include "verbs.h"

namespace splatbus::cli {

using Json = nlohmann::json;

int echo_topics(const TopicOptions& options) {
  const StopSignals signals;
  if (options.csv && options.fields.empty()) throw std::runtime_error("--csv needs --field, once for each column");
  const std::uint64_t wanted = options.once ? 1 : options.count;
  std::optional<MessageFilter> filter;
  if (!options.filter.empty()) filter.emplace(options.filter);
  bus::Subscriber subscriber(connect(bus_address(options.bus)), options.topics);
  SchemaJson schemas;
  std::uint64_t shown = 0;
  for (const Deadline deadline(options.seconds); !deadline.passed() && !signals.stop().stop_requested();) {
    const auto message = subscriber.receive(kPatience);
    if (!message) continue;
    try {
      const Json body = schemas.to_json(*message);
      if (filter && !filter->holds(body)) continue;
      if (options.csv) {
        if (shown == 0) print(csv_line(options.fields));
        print(csv_line(values_of(body, options.fields)));
      } else if (!options.fields.empty()) {
        print(fmt::format("{}", fmt::join(values_of(body, options.fields), " ")));
      } else {
        const Json json{{"topic", message->topic()}, {"message", body}};
        print(options.json ? json_text(json) : fmt::format("--- {}\n{}", message->topic(), json_text(body, 2)));
      }
    } catch (const bus::Error& error) {
      fmt::print(stderr, "splatbus topic echo: {}\n", error.what());
      continue;
    }
    if (++shown == wanted) return 0;
  }
  return wanted > 0 ? 1 : 0;
}

}  // namespace splatbus::cli
