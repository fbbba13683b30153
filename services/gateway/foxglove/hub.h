#pragma once

#include <array>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <span>
#include <stop_token>
#include <string>
#include <string_view>
#include <vector>

#include "bus/rights.h"
#include "gateway/foxglove/outbox.h"
#include "gateway/foxglove/parameter_board.h"
#include "gateway/foxglove/protocol.h"
#include "gateway/traffic.h"

namespace splatbus::gateway::foxglove {

/// A channel's topic and schema, as the bus or what is made of it offers them.
struct Offer {
  std::string topic, schema_name;
  std::span<const std::uint8_t> schema;
  std::vector<std::string> publishers;  ///< sources on the bus
};

/// Who has connected, what they want, and what waits for them: the protocol without sockets and without a bus.
/// Thread-safe: sessions call it from the server's thread, the Feed from its own.
class Hub {
 public:
  using ClientId = std::uint64_t;
  /// Publishes control/<source>.
  using SetParameters = std::function<void(const std::string& source, const NamedValues& changes)>;

  Hub(std::size_t max_clients, std::size_t max_queue_bytes, std::string session_id);

  // For sessions.

  [[nodiscard]] bool has_room() const;
  /// `wake` is called, from any thread, when there is something to take() after there was nothing.
  ClientId join(std::function<void()> wake);
  void leave(ClientId client);
  /// Nobody is woken any more: what `wake` needs is about to go.
  void leave_all();
  /// What is to be sent next, if anything is.
  [[nodiscard]] std::optional<OutgoingMessage> take(ClientId client);

  enum class Reception : std::uint8_t { Understood, Forbidden, Malformed };
  /// Of a client's message. An asset that is asked for is left in `asset`, for the session to answer.
  struct AssetRequest {
    std::uint32_t id = 0;
    std::string uri;
  };
  Reception receive(ClientId client, std::span<const std::uint8_t> message, bool binary, const bus::Rights& rights,
                    std::int64_t now_ns, std::optional<AssetRequest>& asset);
  /// An answer that was made elsewhere.
  void answer(ClientId client, OutgoingMessage message);
  /// False when it reads nothing of what it is told: it is to be ended.
  [[nodiscard]] bool reads(ClientId client) const;

  [[nodiscard]] FoxgloveFigures figures() const;

  // For the Feed.

  void on_set(SetParameters set);
  /// Waits until somebody is there; false at the stop.
  bool wait_for_client(std::stop_token stop);
  /// Topics of channels that somebody is subscribed to, each with a number that is another one when nobody was for a
  /// while; nullopt when nobody is there.
  using Wanted = std::map<std::string, std::uint64_t>;
  [[nodiscard]] std::optional<Wanted> wanted() const;
  /// Nothing is read from the bus any more: what has been heard() and listed() grows old.
  void forget();
  /// Which channels there are of one kind; those of that kind that are not named are gone.
  enum class Kind : std::uint8_t { Bus, Fixed, Cameras };
  void offer(Kind kind, const std::vector<Offer>& offers);
  /// Hands a message to those who are subscribed. With `keep`, it is also the first that later ones get, until another
  /// of its topic and key comes.
  void deliver(const std::string& topic, std::uint64_t time_ns, Payload payload,
               const std::optional<std::string>& keep = {});
  void tell_time(std::uint64_t time_ns);
  void heard(const std::string& source, const NamedParameters& parameters, std::int64_t now_ns);
  /// By source, whether it is alive, as the broker lists them.
  void listed(const std::map<std::string, bool>& sources, std::int64_t now_ns);
  /// An error that a service has logged: perhaps why it did not set a parameter.
  void logged_error(const std::string& source, const std::string& text);
  void expire(std::int64_t now_ns);

 private:
  /// A setParameters that services have not answered yet.
  struct Setting {
    std::optional<std::string> request_id;
    std::vector<std::string> names;           ///< all that were named, to answer with
    std::map<std::string, std::string> open;  ///< by name, the value that was asked for
    std::int64_t until_ns = 0;
  };
  /// A getParameters of before the services had been heard.
  struct Question {
    std::vector<std::string> names;
    std::optional<std::string> request_id;
    std::int64_t until_ns = 0;
  };
  struct Client {
    std::function<void()> wake;
    Outbox outbox;
    std::map<std::uint32_t, std::uint32_t> subscriptions;  ///< channel by id
    std::set<std::string> parameters;
    bool all_parameters = false, graph = false, woken = false, reads = true;
    std::vector<Setting> settings;
    std::vector<Question> questions;
    std::uint64_t dropped_said = 0;
    std::int64_t said_ns = 0;
  };
  struct Known {
    Channel channel;
    Kind kind = Kind::Bus;
    bool offered = false;
    std::vector<std::string> publishers;
    std::size_t subscribers = 0, kept_bytes = 0;
    std::uint64_t wanted = 0;  ///< how often the first has come
    struct Kept {
      std::uint64_t time_ns = 0;
      Payload payload;
    };
    std::map<std::string, Kept> kept;  ///< by key
  };

  void send(Client& client, OutgoingMessage message);
  void send_data(Client& client, OutgoingMessage message);
  static void wake(Client& client);
  void say(Client& client, Level level, const std::string& text, const std::string& id = {});
  void subscribe(Client& client, const ClientMessage& message);
  void drop(Known& known);
  [[nodiscard]] Reception set(Client& client, const ClientMessage& message, const bus::Rights& rights,
                              std::int64_t now_ns);
  void close_settings(Client& client);
  void get(Client& client, const ClientMessage& message, std::int64_t now_ns);
  void answer_questions(Client& client, std::int64_t now_ns);
  void tell_changed(const NamedParameters& changed);
  void say_dropped(Client& client, std::int64_t now_ns);
  void send_graph(Client& client, const std::vector<std::string>& removed = {});
  void send_graphs(const std::vector<std::string>& removed = {});
  [[nodiscard]] std::vector<Channel> offered() const;

  mutable std::mutex mutex_;
  std::condition_variable_any somebody_;
  const std::size_t max_clients_, max_queue_bytes_;
  const std::string session_id_;
  SetParameters set_;
  ClientId next_client_ = 1;
  std::map<ClientId, Client> clients_;
  std::map<std::string, Known> channels_;          ///< by topic; ids stay with them
  std::map<std::uint32_t, std::string> topic_of_;  ///< by channel id
  ParameterBoard board_;
  std::uint64_t dropped_before_ = 0;  ///< of clients that have left
};

}  // namespace splatbus::gateway::foxglove
