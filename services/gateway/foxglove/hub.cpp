#include "gateway/foxglove/hub.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace splatbus::gateway::foxglove {

namespace {

constexpr std::size_t kMaxChannels = 4096, kMaxSubscriptions = 1024, kMaxParameterNames = 4096;
constexpr std::size_t kMaxKept = 128, kMaxKeptBytes = std::size_t{8} << 20;
constexpr std::int64_t kDropsEveryNs = 1'000'000'000;

}  // namespace

Hub::Hub(std::size_t max_clients, std::size_t max_queue_bytes, std::string session_id)
    : max_clients_(max_clients), max_queue_bytes_(max_queue_bytes), session_id_(std::move(session_id)) {}

bool Hub::has_room() const {
  const std::scoped_lock lock(mutex_);
  return clients_.size() < max_clients_;
}

Hub::ClientId Hub::join(std::function<void()> wake) {
  const std::scoped_lock lock(mutex_);
  const ClientId id = next_client_++;
  Client& client =
      clients_.emplace(id, Client{.wake = std::move(wake), .outbox = Outbox(max_queue_bytes_)}).first->second;
  send(client, server_info(session_id_));
  send(client, advertise(offered()));
  somebody_.notify_all();
  return id;
}

void Hub::leave(ClientId id) {
  const std::scoped_lock lock(mutex_);
  const auto found = clients_.find(id);
  if (found == clients_.end()) return;
  dropped_before_ += found->second.outbox.dropped();
  for (const auto& [subscription, channel] : found->second.subscriptions) drop(channels_.at(topic_of_.at(channel)));
  clients_.erase(found);
}

void Hub::leave_all() {
  std::vector<ClientId> all;
  {
    const std::scoped_lock lock(mutex_);
    for (const auto& [id, client] : clients_) all.push_back(id);
  }
  for (const ClientId id : all) leave(id);
}

std::optional<OutgoingMessage> Hub::take(ClientId id) {
  const std::scoped_lock lock(mutex_);
  const auto found = clients_.find(id);
  if (found == clients_.end()) return std::nullopt;
  auto message = found->second.outbox.take();
  if (!message) found->second.woken = false;
  return message;
}

void Hub::answer(ClientId id, OutgoingMessage message) {
  const std::scoped_lock lock(mutex_);
  if (const auto found = clients_.find(id); found != clients_.end()) send(found->second, std::move(message));
}

bool Hub::reads(ClientId id) const {
  const std::scoped_lock lock(mutex_);
  const auto found = clients_.find(id);
  return found != clients_.end() && found->second.reads;
}

FoxgloveFigures Hub::figures() const {
  const std::scoped_lock lock(mutex_);
  FoxgloveFigures figures{.clients = clients_.size(), .dropped = dropped_before_};
  for (const auto& [id, client] : clients_) {
    figures.queued_bytes += client.outbox.bytes();
    figures.dropped += client.outbox.dropped();
  }
  return figures;
}

void Hub::wake(Client& client) {
  if (!std::exchange(client.woken, true)) client.wake();
}

void Hub::send(Client& client, OutgoingMessage message) {
  client.reads = client.outbox.answer(std::move(message)) && client.reads;
  wake(client);
}

void Hub::send_data(Client& client, OutgoingMessage message) {
  client.outbox.data(std::move(message));
  wake(client);
}

void Hub::say(Client& client, Level level, const std::string& text, const std::string& id) {
  send(client, status(level, text, id));
}

Hub::Reception Hub::receive(ClientId id, std::span<const std::uint8_t> bytes, bool binary, const bus::Rights& rights,
                            std::int64_t now_ns, std::optional<AssetRequest>& asset) {
  using Operation = ClientMessage::Operation;
  const auto parsed =
      binary ? parse_binary(bytes) : parse_text({reinterpret_cast<const char*>(bytes.data()), bytes.size()});
  if (!parsed) return Reception::Malformed;
  const std::scoped_lock lock(mutex_);
  const auto found = clients_.find(id);
  if (found == clients_.end()) return Reception::Understood;
  Client& client = found->second;
  const ClientMessage& message = *parsed;
  switch (message.operation) {
    case Operation::Subscribe:
      subscribe(client, message);
      break;
    case Operation::Unsubscribe:
      for (const std::uint32_t subscription : message.ids) {
        const auto known = client.subscriptions.find(subscription);
        if (known == client.subscriptions.end()) continue;
        drop(channels_.at(topic_of_.at(known->second)));
        client.subscriptions.erase(known);
      }
      send_graphs();
      break;
    case Operation::GetParameters:
      get(client, message, now_ns);
      break;
    case Operation::SetParameters:
      return set(client, message, rights, now_ns);
    case Operation::SubscribeParameters:
      client.all_parameters = client.all_parameters || message.names.empty();
      for (const std::string& name : message.names) {
        if (client.parameters.size() < kMaxParameterNames) client.parameters.insert(name);
      }
      break;
    case Operation::UnsubscribeParameters:
      if (message.names.empty()) {
        client.all_parameters = false;
        client.parameters.clear();
      }
      for (const std::string& name : message.names) client.parameters.erase(name);
      break;
    case Operation::SubscribeGraph:
      client.graph = true;
      send_graph(client);
      break;
    case Operation::UnsubscribeGraph:
      client.graph = false;
      break;
    case Operation::FetchAsset:
      asset = AssetRequest{message.asset_request, message.text};
      break;
    case Operation::Unsupported:
      say(client, Level::Error, fmt::format("{:.64} is not offered here", message.text), "unsupported");
      break;
  }
  return Reception::Understood;
}

void Hub::subscribe(Client& client, const ClientMessage& message) {
  for (const auto& [subscription, channel] : message.subscriptions) {
    const auto topic = topic_of_.find(channel);
    if (topic == topic_of_.end() || !channels_.at(topic->second).offered) {
      say(client, Level::Warning, fmt::format("there is no channel {}", channel));
    } else if (client.subscriptions.contains(subscription) || client.subscriptions.size() >= kMaxSubscriptions) {
      say(client, Level::Error, fmt::format("subscription {} is in use, or one too many", subscription));
    } else {
      client.subscriptions.emplace(subscription, channel);
      Known& known = channels_.at(topic->second);
      if (known.subscribers++ == 0) ++known.wanted;
      for (const auto& [key, kept] : known.kept) {
        send_data(client, message_data(subscription, kept.time_ns, kept.payload));
      }
    }
  }
  send_graphs();
}

void Hub::drop(Known& known) {
  if (--known.subscribers > 0) return;
  known.kept.clear();
  known.kept_bytes = 0;
}

void Hub::on_set(SetParameters set) {
  const std::scoped_lock lock(mutex_);
  set_ = std::move(set);
}

bool Hub::wait_for_client(std::stop_token stop) {
  std::unique_lock lock(mutex_);
  return somebody_.wait(lock, std::move(stop), [this] { return !clients_.empty(); });
}

std::optional<Hub::Wanted> Hub::wanted() const {
  const std::scoped_lock lock(mutex_);
  if (clients_.empty()) return std::nullopt;
  Wanted topics;
  for (const auto& [topic, known] : channels_) {
    if (known.subscribers > 0) topics.emplace(topic, known.wanted);
  }
  return topics;
}

void Hub::forget() {
  const std::scoped_lock lock(mutex_);
  board_.clear();
}

std::vector<Channel> Hub::offered() const {
  std::vector<Channel> channels;
  for (const auto& [topic, known] : channels_) {
    if (known.offered) channels.push_back(known.channel);
  }
  return channels;
}

void Hub::offer(Kind kind, const std::vector<Offer>& offers) {
  const std::scoped_lock lock(mutex_);
  std::vector<Channel> added;
  std::vector<std::uint32_t> gone;
  std::vector<std::string> gone_topics;
  bool other_publishers = false;
  for (const Offer& offer : offers) {
    if (!channels_.contains(offer.topic)) {
      if (channels_.size() >= kMaxChannels) continue;
      const auto id = static_cast<std::uint32_t>(channels_.size() + 1);
      topic_of_[id] = offer.topic;
      channels_[offer.topic] = {
          .channel = {.id = id, .topic = offer.topic, .schema_name = offer.schema_name, .schema = offer.schema},
          .kind = kind};
    }
    Known& known = channels_.at(offer.topic);
    // An id stands for one schema for good.
    if (known.kind != kind || known.channel.schema_name != offer.schema_name) continue;
    if (!std::exchange(known.offered, true)) added.push_back(known.channel);
    other_publishers = other_publishers || known.publishers != offer.publishers;
    known.publishers = offer.publishers;
  }
  for (auto& [topic, known] : channels_) {
    const auto is_it = [&, name = &topic, schema = &known.channel.schema_name](const Offer& offer) {
      return offer.topic == *name && offer.schema_name == *schema;
    };
    if (known.kind != kind || !known.offered || std::any_of(offers.begin(), offers.end(), is_it)) continue;
    known.offered = false;
    gone.push_back(known.channel.id);
    gone_topics.push_back(topic);
  }
  for (auto& [id, client] : clients_) {
    if (!added.empty()) send(client, advertise(added));
    if (gone.empty()) continue;
    send(client, unadvertise(gone));
    std::erase_if(client.subscriptions, [&](const auto& subscription) {
      if (std::find(gone.begin(), gone.end(), subscription.second) == gone.end()) return false;
      drop(channels_.at(topic_of_.at(subscription.second)));
      return true;
    });
  }
  if (!added.empty() || !gone.empty() || other_publishers) send_graphs(gone_topics);
}

void Hub::deliver(const std::string& topic, std::uint64_t time_ns, Payload payload,
                  const std::optional<std::string>& keep) {
  const std::scoped_lock lock(mutex_);
  const auto found = channels_.find(topic);
  if (found == channels_.end() || found->second.subscribers == 0) return;
  Known& known = found->second;
  for (auto& [id, client] : clients_) {
    for (const auto& [subscription, channel] : client.subscriptions) {
      if (channel == known.channel.id) send_data(client, message_data(subscription, time_ns, payload));
    }
  }
  if (!keep) return;
  auto& before = known.kept[*keep];
  known.kept_bytes += payload->size() - (before.payload ? before.payload->size() : 0);
  before = {time_ns, std::move(payload)};
  while (known.kept.size() > kMaxKept || (known.kept_bytes > kMaxKeptBytes && known.kept.size() > 1)) {
    const auto oldest = std::min_element(known.kept.begin(), known.kept.end(), [](const auto& a, const auto& b) {
      return a.second.time_ns < b.second.time_ns;
    });
    known.kept_bytes -= oldest->second.payload->size();
    known.kept.erase(oldest);
  }
}

void Hub::tell_time(std::uint64_t time_ns) {
  const std::scoped_lock lock(mutex_);
  for (auto& [id, client] : clients_) send_data(client, time(time_ns));
}

void Hub::say_dropped(Client& client, std::int64_t now_ns) {
  const std::uint64_t dropped = client.outbox.dropped();
  if (dropped == client.dropped_said || now_ns - client.said_ns < kDropsEveryNs) return;
  client.dropped_said = dropped;
  client.said_ns = now_ns;
  say(client, Level::Warning, fmt::format("{} messages left out: more is subscribed to than is read", dropped),
      "dropped");
}

void Hub::send_graph(Client& client, const std::vector<std::string>& removed) {
  Endpoints published, subscribed;
  for (const auto& [topic, known] : channels_) {
    if (!known.offered) continue;
    published.emplace_back(topic, known.publishers);
    std::vector<std::string> subscribers;
    for (const auto& [id, other] : clients_) {
      const auto is_it = [&, channel = known.channel.id](const auto& one) { return one.second == channel; };
      if (std::any_of(other.subscriptions.begin(), other.subscriptions.end(), is_it)) {
        subscribers.push_back(fmt::format("foxglove-{}", id));
      }
    }
    subscribed.emplace_back(topic, std::move(subscribers));
  }
  send(client, connection_graph(published, subscribed, removed));
}

void Hub::send_graphs(const std::vector<std::string>& removed) {
  for (auto& [id, client] : clients_) {
    if (client.graph) send_graph(client, removed);
  }
}

}  // namespace splatbus::gateway::foxglove
