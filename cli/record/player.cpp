#include "player.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <chrono>
#include <stdexcept>
#include <tuple>

#include "bus/clock.h"
#include "bus/error.h"
#include "recording_file.h"
#include "topic_filter.h"

namespace splatbus::cli {

namespace {

constexpr std::size_t kRingBytes = std::size_t{64} << 20;
constexpr std::size_t kMinSlots = 8, kMaxSlots = 64;
constexpr std::size_t kLatchedSlots = 4;  // what it replaces may still be read
constexpr std::size_t kMaxRings = 512;
constexpr std::size_t kMaxSources = 64;
constexpr std::chrono::seconds kBusPatience(10);
constexpr double kMaxSeconds = 1e9;  // what a file can claim of its length
constexpr std::int64_t kSecondNs = 1'000'000'000;
constexpr std::int64_t kMinLoopNs = kSecondNs / 10;

std::int64_t number_in(const mcap::StringMap& values, const std::string& key) {
  std::int64_t number = 0;
  const auto found = values.find(key);
  if (found != values.end()) std::from_chars(found->second.data(), found->second.data() + found->second.size(), number);
  return number;
}

std::size_t bytes_of(const std::vector<bus::OutgoingTensor>& tensors) {
  std::size_t bytes = 0;
  for (const auto& tensor : tensors) bytes += bus::aligned(bus::tensor_bytes(tensor.shape, tensor.type));
  return bytes;
}

}  // namespace

Player::Player(mcap::Reader& reader, bus::Address address, PlayOptions options)
    : reader_(reader), address_(std::move(address)), options_(std::move(options)) {
  for (const mcap::Metadata& metadata : reader_.read_metadata()) {
    if (metadata.name == kRecordingMetadata) {
      knows_clock_ = metadata.values.contains("realtime_minus_monotonic_ns");
      realtime_minus_monotonic_ns_ = number_in(metadata.values, "realtime_minus_monotonic_ns");
    } else if (metadata.name == kLargestMetadata) {
      for (const auto& [topic, bytes] : metadata.values) {
        largest_[topic] = static_cast<std::size_t>(
            std::clamp<std::int64_t>(number_in(metadata.values, topic), 0, std::int64_t{1} << 30));
      }
    }
  }
  const mcap::Statistics& statistics = reader_.summary().statistics;
  begin_log_time_ = statistics.message_start_time + static_cast<std::uint64_t>(options_.start_s * 1e9);
  end_log_time_ = statistics.message_end_time;
  if (options_.duration_s > 0) {
    end_log_time_ = std::min(end_log_time_, begin_log_time_ + static_cast<std::uint64_t>(options_.duration_s * 1e9));
  }
}

PlayState Player::run(const std::stop_token& stop, const std::function<void(const PlayState&)>& each_second) {
  each_second_ = each_second;
  next_second_ns_ = bus::now_ns() + kSecondNs;
  do {
    begin_ns_ = bus::now_ns();
    held_ns_ = 0;
    const std::uint64_t before = state_.messages;
    if (options_.start_s > 0) say_latched(begin_log_time_);
    play_once(stop);
    // One that is over at once would flood the bus.
    if (options_.loop && wait_until(begin_ns_ + kMinLoopNs, stop)) step();
    ++state_.loops;
    if (state_.messages == before) break;  // nothing to play: not for ever
  } while (options_.loop && !stop.stop_requested());
  return state_;
}

void Player::note(const std::string& problem) {
  if (state_.unreadable++ == 0) state_.first_problem = problem;
}

// Each topic's last message before that time, of each latch key and source.
void Player::say_latched(std::uint64_t before) {
  std::map<std::tuple<std::string, std::string, std::string>, std::pair<std::uint64_t, std::vector<std::byte>>> held;
  std::map<std::uint64_t, std::pair<const mcap::Channel*, const std::vector<std::byte>*>> in_order;
  const auto& summary = reader_.summary();
  std::uint64_t order = 0;
  for (std::size_t chunk = 0; chunk < summary.chunks.size(); ++chunk) {
    const mcap::ChunkIndex& index = summary.chunks[chunk];
    if (index.message_start_time >= before) continue;
    const bool latched =
        index.message_index_offsets.empty() || std::ranges::any_of(index.message_index_offsets, [&](const auto& entry) {
          const auto channel = summary.channels.find(entry.first);
          return channel == summary.channels.end() ||
                 (channel->second.metadata.contains("latched") && channel->second.metadata.at("latched") == "true");
        });
    if (!latched) continue;
    try {
      reader_.read_chunk(chunk, [&](const mcap::Message& message) {
        const mcap::Channel& channel = summary.channels.at(message.channel_id);
        if (message.log_time >= before || !is_wanted(channel)) return;
        try {
          const RecordedMessage recorded(channel.topic, message.data);
          const wire::Header& header = recorded.header();
          if (!header.latch()) return;
          const std::string key = header.latch_key() == nullptr ? "" : header.latch_key()->str();
          held[{header.source()->str(), channel.topic, key}] = {
              ++order, std::vector<std::byte>(message.data.begin(), message.data.end())};
          in_order.emplace(order, std::pair(&channel, nullptr));
        } catch (const bus::Error&) {  // said when it is its turn
        }
      });
    } catch (const mcap::Error&) {  // as above
    }
  }
  for (const auto& [key, entry] : held) in_order.at(entry.first).second = &entry.second;
  for (const auto& [number, entry] : in_order) {
    if (entry.second == nullptr) continue;
    take(*entry.first, *entry.second);
  }
}

void Player::play_once(const std::stop_token& stop) {
  const auto& summary = reader_.summary();
  for (std::size_t chunk = 0; chunk < summary.chunks.size() && !stop.stop_requested(); ++chunk) {
    const mcap::ChunkIndex& index = summary.chunks[chunk];
    if (index.message_end_time < begin_log_time_ || index.message_start_time > end_log_time_) continue;
    try {
      reader_.read_chunk(chunk, [&](const mcap::Message& message) {
        if (stop.stop_requested() || message.log_time < begin_log_time_ || message.log_time > end_log_time_) return;
        if (!is_wanted(summary.channels.at(message.channel_id))) return;
        const bool stepped = wait_until(due_ns(message.log_time), stop);
        hold(message.log_time, stop);
        if (stop.stop_requested()) return;
        state_.position_s = static_cast<double>(message.log_time - summary.statistics.message_start_time) / 1e9;
        const std::uint64_t before = state_.messages;
        take(summary.channels.at(message.channel_id), message.data);
        if (!stepped) return;
        if (state_.messages == before) step();  // that was one that is not played
        report(bus::now_ns());
      });
    } catch (const mcap::Error& error) {
      note(error.what());
    }
  }
  if (wait_until(due_ns(std::max(begin_log_time_, end_log_time_)), stop)) step();
}

void Player::toggle_pause() {
  const std::scoped_lock lock(mutex_);
  paused_ = !paused_;
  steps_ = 0;
  changed_.notify_all();
}

void Player::step() {
  const std::scoped_lock lock(mutex_);
  if (paused_) ++steps_;
  changed_.notify_all();
}

void Player::report(std::int64_t now_ns) {
  each_second_(state_);
  next_second_ns_ = now_ns + kSecondNs;
}

std::int64_t Player::due_ns(std::uint64_t log_time) const {
  const double after_s = static_cast<double>(log_time - begin_log_time_) / 1e9 / options_.rate;
  return begin_ns_ + held_ns_ + static_cast<std::int64_t>(std::min(after_s, kMaxSeconds) * 1e9);
}

void Player::hold(std::uint64_t log_time, const std::stop_token& stop) {
  if (!options_.hold) return;
  const std::int64_t from_ns = bus::now_ns();
  options_.hold(log_time, stop);
  held_ns_ += bus::now_ns() - from_ns;
}

bool Player::wait_until(std::int64_t time_ns, const std::stop_token& stop) {
  std::int64_t before = bus::now_ns();
  for (std::int64_t now = before; !stop.stop_requested(); now = bus::now_ns()) {
    if (now >= next_second_ns_) report(now);
    std::unique_lock lock(mutex_);
    const bool paused = paused_;
    if (state_.paused) {  // what has passed since then does not count
      time_ns += now - before;
      held_ns_ += now - before;
    }
    before = now;
    if (paused != state_.paused) {
      state_.paused = paused;
      lock.unlock();
      report(now);
      continue;
    }
    if (paused && steps_ > 0) {
      --steps_;
      held_ns_ += now - time_ns;
      return true;
    }
    if (!paused && now >= time_ns) {
      state_.late_ns = std::max(state_.late_ns, now - time_ns);
      return false;
    }
    const std::int64_t until_ns = paused ? next_second_ns_ : std::min(time_ns, next_second_ns_);
    changed_.wait_for(lock, stop, std::chrono::nanoseconds(until_ns - now),
                      [&] { return paused_ != paused || steps_ > 0; });
  }
  return false;
}

bool Player::is_wanted(const mcap::Channel& channel) const {
  return channel.message_encoding == "flatbuffer" && matches_any(options_.topics, channel.topic) &&
         !matches_any(options_.exclude, channel.topic);
}

void Player::take(const mcap::Channel& channel, std::span<const std::byte> data) {
  try {
    RecordedMessage recorded(channel.topic, data);
    publish(channel, recorded);
  } catch (const bus::Error& error) {
    note(error.what());
  }
}

void Player::publish(const mcap::Channel& channel, RecordedMessage& message) {
  const wire::Header& header = message.header();
  const std::string source = header.source()->str();
  if (options_.silent.contains(source) ||
      (!options_.sources.empty() && std::ranges::find(options_.sources, source) == options_.sources.end())) {
    return;
  }
  if (message.lacks_tensors()) {
    ++state_.without_tensors;
    return;
  }
  const auto remapped = options_.remap.find(channel.topic);
  const std::string& topic = remapped == options_.remap.end() ? channel.topic : remapped->second;
  Speaker& speaker = speaker_of(source);
  bus::Publisher::Again again{
      .epoch = std::max(speaker.publisher->context()->epoch(), static_cast<std::uint64_t>(begin_ns_)),
      .capture_ns = header.capture_ns(),
      .publish_ns = header.publish_ns(),
      .tensors = place(speaker, topic, message)};
  if (!options_.recorded_clock) {
    const std::int64_t age_ns = header.capture_ns() == 0 ? 0 : header.publish_ns() - header.capture_ns();
    again.publish_ns = bus::now_ns();
    again.capture_ns = header.capture_ns() == 0 ? 0 : again.publish_ns - age_ns;
    const std::int64_t began_ns = static_cast<std::int64_t>(begin_log_time_) - realtime_minus_monotonic_ns_;
    if (knows_clock_) message.shift_scene_version(static_cast<std::uint64_t>(begin_ns_ - began_ns));
  }
  speaker.publisher->publish_again(topic, message.body(), again);
  ++state_.messages;
  ++state_.sources[source];
  state_.bytes += message.body().size() + bytes_of(message.tensors());
}

std::vector<bus::OutgoingTensor> Player::place(Speaker& speaker, const std::string& topic,
                                               const RecordedMessage& message) {
  if (message.tensors().empty() || !address_.is_local()) return message.tensors();
  const wire::Header& header = message.header();
  const std::string key = header.latch() && header.latch_key() != nullptr ? header.latch_key()->str() : "";
  auto ring = speaker.rings.find({topic, key});
  if (ring == speaker.rings.end()) {
    if (rings_ == kMaxRings) return message.tensors();
    const std::size_t bytes = std::max(bytes_of(message.tensors()), largest_[topic]);
    const std::size_t slots =
        header.latch() ? kLatchedSlots : std::clamp(kRingBytes / std::max<std::size_t>(bytes, 1), kMinSlots, kMaxSlots);
    const std::string role = fmt::format("{:.96}-{}", topic, ++rings_);
    ring = speaker.rings
               .try_emplace({topic, key}, speaker.publisher->context(), role, slots,
                            header.latch() ? bytes_of(message.tensors()) : bytes)
               .first;
  }
  std::vector<bus::TensorSource> sources;
  for (const bus::OutgoingTensor& tensor : message.tensors()) {
    sources.push_back({tensor.name, tensor.shape, tensor.type, tensor.inline_data, Device::Cpu});
  }
  try {
    return ring->second.write(sources);
  } catch (const bus::Error& error) {
    throw std::runtime_error(fmt::format("cannot play {} as '{}': {}", topic, header.source()->str(), error.what()));
  }
}

Player::Speaker& Player::speaker_of(const std::string& source) {
  const auto found = speakers_.find(source);
  if (found != speakers_.end()) return found->second;
  if (speakers_.size() == kMaxSources) throw bus::Error(fmt::format("more than {} sources", kMaxSources));
  // Of what is latched only the last would wait for the broker.
  const auto context = bus::Context::create(address_, source);
  if (!context->wait_connected(kBusPatience)) throw std::runtime_error(fmt::format("no bus at {}", address_.text()));
  Speaker speaker{.publisher = std::make_unique<bus::Publisher>(context), .rings = {}};
  return speakers_.emplace(source, std::move(speaker)).first->second;
}

}  // namespace splatbus::cli
