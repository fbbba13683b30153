#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <stdexcept>
#include <vector>

#include "bus/nearest.h"
#include "message_filter.h"
#include "schema_json.h"
#include "supervised_run.h"
#include "topic_verbs.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;

/// Says once, on standard error, which of the topics that are asked for nobody has published since the broker started:
/// a name may be mistyped, or its time may come.
class AbsentTopics {
 public:
  AbsentTopics(const std::shared_ptr<bus::Context>& context, const TopicOptions& options)
      : options_(options), broker_(context) {
    broker_.on(topics::kTopics, [this](const wire::Topics& topics, const bus::Message& message) {
      known_ = read_topics(topics);
      is_fresh_ = !message.header().resent();
    });
  }

  void heard(const std::string& topic) { heard_.insert(topic); }
  /// Says it by what the broker has said since this began; with `now`, by what there is.
  void look(bool now = false) {
    if (told_) return;
    broker_.dispatch_all(std::chrono::milliseconds(0));
    if (!known_ || (!is_fresh_ && !now)) return;
    told_ = true;
    std::vector<std::string> there(heard_.begin(), heard_.end());
    for (const auto& [topic, seen] : known_->topics) there.push_back(topic);
    name_absent("echo", options_, there);
  }

 private:
  const TopicOptions& options_;
  bus::Subscriber broker_;
  std::optional<TopicSnapshot> known_;
  std::set<std::string> heard_;
  bool is_fresh_ = false, told_ = false;
};

}  // namespace

int echo_topics(const TopicOptions& options) {
  const StopSignals signals;
  if (options.csv && options.fields.empty()) throw std::runtime_error("--csv needs --field, once for each column");
  const std::uint64_t wanted = options.once ? 1 : options.count;
  std::optional<MessageFilter> filter;
  if (!options.filter.empty()) filter.emplace(options.filter);
  const auto context = connect(bus_address(options.bus));
  bus::Subscriber subscriber(context, options.topics);
  AbsentTopics absent(context, options);
  SchemaJson schemas;
  std::uint64_t shown = 0;
  for (const Deadline deadline(options.seconds); !deadline.passed() && !signals.stop().stop_requested();) {
    const auto message = subscriber.receive(kPatience);
    if (message) absent.heard(std::string(message->topic()));
    absent.look();
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
  if (shown == 0) absent.look(true);
  return wanted > 0 || shown == 0 ? 1 : 0;
}

}  // namespace splatbus::cli
