#include <fmt/chrono.h>
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <ctime>
#include <nlohmann/json.hpp>

#include "mcap/reader.h"
#include "record.h"
#include "recording_file.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;

std::string text_of(const Json& json) {
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

Json describe(const mcap::Reader& reader) {
  const mcap::Summary& summary = reader.summary();
  const mcap::Statistics& statistics = summary.statistics;
  const double seconds = static_cast<double>(statistics.message_end_time - statistics.message_start_time) / 1e9;
  std::uint64_t raw = 0, packed = 0;
  for (const mcap::ChunkIndex& chunk : summary.chunks) {
    raw += chunk.uncompressed_size;
    packed += chunk.compressed_size;
  }
  Json channels = Json::array();
  for (const auto& [id, channel] : summary.channels) {
    const auto counted = statistics.channel_message_counts.find(id);
    const std::uint64_t messages = counted == statistics.channel_message_counts.end() ? 0 : counted->second;
    const auto named = [&channel = channel](const char* key) {
      const auto found = channel.metadata.find(key);
      return found == channel.metadata.end() ? std::string() : found->second;
    };
    channels.push_back({{"topic", channel.topic},
                        {"schema", named("schema")},
                        {"latched", named("latched") == "true"},
                        {"messages", messages},
                        {"rate_hz", seconds > 0 ? static_cast<double>(messages) / seconds : 0}});
  }
  Json metadata = Json::object();
  for (const mcap::Metadata& entry : reader.read_metadata()) metadata[entry.name] = entry.values;
  return {{"library", reader.header().library},
          {"bytes", reader.size()},
          {"start_ns", statistics.message_start_time},
          {"seconds", seconds},
          {"messages", statistics.message_count},
          {"chunks", summary.chunks.size()},
          {"uncompressed_bytes", raw},
          {"compressed_bytes", packed},
          {"damage", reader.damage()},
          {"channels", channels},
          {"metadata", metadata}};
}

int show(const std::string& path, bool json) {
  const mcap::Reader reader(path);
  const Json info = describe(reader);
  if (json) {
    fmt::print("{}\n", text_of(info));
    return 0;
  }
  const auto& statistics = reader.summary().statistics;
  const auto start_s = static_cast<std::time_t>(statistics.message_start_time / 1'000'000'000);
  fmt::print("file      {} ({:.1f} MB, written by {})\n", path, static_cast<double>(reader.size()) / 1e6,
             reader.header().library);
  if (statistics.message_count > 0 && start_s < std::time_t{1} << 40) {
    fmt::print("start     {:%Y-%m-%d %H:%M:%S}\n", fmt::localtime(start_s));
  }
  fmt::print("duration  {:.1f} s\nmessages  {}\n", info["seconds"].get<double>(), statistics.message_count);
  const double raw = info["uncompressed_bytes"], packed = info["compressed_bytes"];
  fmt::print("chunks    {} ({:.1f} MB, {:.0f} % of {:.1f} MB)\n", info["chunks"].get<std::size_t>(), packed / 1e6,
             raw > 0 ? 100 * packed / raw : 0, raw / 1e6);
  if (!reader.damage().empty()) {
    fmt::print("damage    {}\n          (what is whole can be played; `splatbus record recover` completes the file)\n",
               reader.damage());
  }
  fmt::print("\n{:<24} {:>8} {:>9}  {}\n", "TOPIC", "MESSAGES", "HZ", "SCHEMA");
  for (const Json& channel : info["channels"]) {
    fmt::print("{:<24} {:>8} {:>9.2f}  {}{}\n", channel["topic"].get<std::string>(),
               channel["messages"].get<std::uint64_t>(), channel["rate_hz"].get<double>(),
               channel["schema"].get<std::string>(), channel["latched"].get<bool>() ? " (latched)" : "");
  }
  for (const auto& [name, values] : info["metadata"].items()) {
    if (values.empty() || name == kLargestMetadata) continue;
    fmt::print("\n{}\n", name);
    for (const auto& [key, value] : values.items()) {
      const auto text = value.get<std::string>();
      const auto lines = std::ranges::count(text, '\n');
      fmt::print("  {:<28} {}\n", key, lines > 1 ? fmt::format("({} lines)", lines) : text);
    }
  }
  return 0;
}

}  // namespace

void add_record_info_verb(CLI::App& record, Action& action) {
  auto path = std::make_shared<std::string>();
  auto json = std::make_shared<bool>(false);
  CLI::App* verb = record.add_subcommand("info", "What a recording holds: topics, rates, what is missing and why");
  verb->add_option("file", *path, "recording (.mcap)")->required();
  verb->add_flag("--json", *json, "print it as JSON");
  verb->callback([path, json, &action] { action = [path, json] { return show(*path, *json); }; });
}

}  // namespace splatbus::cli
