#pragma once

#include <cstdint>
#include <string>

#include "topic_watch.h"

namespace splatbus::cli {

// What the verbs of `splatbus topic` do; each returns the exit status.
int list_topics(const TopicOptions& options);
int echo_topics(const TopicOptions& options);

enum class Meter : std::uint8_t { Rate, Bandwidth, Delay };
int meter_topics(const TopicOptions& options, Meter meter);

int describe_topics(const TopicOptions& options);
int graph_topics(const TopicOptions& options, bool dot);

/// Who publishes and who reads the topics that were asked for: "a -> topic -> b" a line, or the DOT language, in which
/// topics are boxes named "/topic", as a source may have a topic's name.
[[nodiscard]] std::string graph_text(const TopicOptions& options, const TopicSnapshot& now, bool dot);

}  // namespace splatbus::cli
