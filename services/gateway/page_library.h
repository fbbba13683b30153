#pragma once

#include <compare>
#include <cstddef>
#include <cstdint>
#include <list>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>
#include <zmq.hpp>

#include "gateway/stream_link.h"
#include "gateway/traffic.h"
#include "stream/packets.h"

namespace splatbus::gateway {

/// What names a page's contents for good.
struct PageName {
  std::uint64_t epoch = 0;
  std::uint32_t page = 0, version = 0;
  auto operator<=>(const PageName&) const = default;
};
/// "/page/EPOCH/PAGE/VERSION", the epoch in 16 hexadecimal digits, the others decimal; nullopt for anything else.
[[nodiscard]] std::optional<PageName> parse_page_path(std::string_view path);
[[nodiscard]] std::string path_of(const PageName& name);
/// Strong: what is named so never changes.
[[nodiscard]] std::string etag_of(const PageName& name);

/// Frozen pages and a manifest of them, as the streamer has them, for whoever speaks HTTP. Both are packets as in a log
/// of what a viewer receives (stream/packet_log.h), without what differs from one run of this process to the next: the
/// same name has the same bytes. Pages are kept in memory up to a ceiling, those that were asked for last. The streamer
/// is asked for what somebody waits for, a few pages at a time, and never for what its manifest does not name. One
/// thread.
class PageLibrary {
 public:
  /// `context` outlives it. Throws bus::Error naming the endpoint.
  PageLibrary(zmq::context_t& context, const std::string& streamer, std::size_t max_bytes, Traffic& traffic);

  enum class State : std::uint8_t { Here, Waits, Absent };
  struct Found {
    State state = State::Waits;
    std::shared_ptr<const std::string> body;  ///< where it is here
    std::string etag;                         ///< the same
  };
  /// Asks the streamer for what is not here: call it again after poll() has returned true, or after a second.
  [[nodiscard]] Found page(const PageName& name, std::int64_t now_ns);
  /// Not older than kFreshNs. Binary, or as JSON.
  [[nodiscard]] Found manifest(bool json, std::int64_t now_ns);

  /// Takes what the streamer has said. True when something has come.
  bool poll(std::int64_t now_ns);
  /// Asks that streamer from now on. True when it asked another one before: descriptor() is another one too.
  bool ask_at(const std::string& streamer);
  /// Edge-triggered: to be waited for after poll() only.
  [[nodiscard]] int descriptor() const { return link_.descriptor(); }

  [[nodiscard]] std::size_t bytes() const { return bytes_; }

  static constexpr std::int64_t kFreshNs = 1'000'000'000;
  static constexpr std::size_t kInFlight = 16;  ///< pages that the streamer is asked for at a time

 private:
  struct Entry {
    PageName name;
    std::shared_ptr<const std::string> body;
  };
  struct Want {
    std::int64_t wanted_ns = 0, asked_ns = 0;
  };
  struct Manifest {
    std::map<std::uint32_t, wire::PageInfo> pages;  ///< frozen ones
    std::uint64_t epoch = 0, gaussians = 0;
    bool begun = false;
  };

  [[nodiscard]] bool knows(const PageName& name) const;
  [[nodiscard]] bool is_fresh(std::int64_t now_ns) const {
    return manifest_ns_ != 0 && now_ns - manifest_ns_ < kFreshNs;
  }
  void want_manifest(std::int64_t now_ns);
  void ask(std::int64_t now_ns);
  void send(bool manifest, const std::vector<PageName>& pages);
  void take(const StreamPacket& packet, std::int64_t now_ns);
  void take_layout(const stream::ParsedPacket& packet);
  void take_manifest(const stream::ParsedPacket& packet, std::int64_t now_ns);
  void take_page(const stream::ParsedPacket& packet);
  void publish(Manifest manifest, std::int64_t now_ns);
  void keep(const PageName& name, std::string body);
  [[nodiscard]] std::string manifest_packets() const;
  [[nodiscard]] std::string manifest_json() const;

  zmq::context_t& context_;
  std::string streamer_;
  StreamLink link_;
  std::size_t max_bytes_, bytes_ = 0;
  Traffic& traffic_;
  std::list<Entry> recent_;  ///< the one asked for last is in front
  std::map<PageName, std::list<Entry>::iterator> kept_;
  std::map<PageName, Want> wants_;
  std::set<PageName> absent_;  ///< of this manifest: the streamer has them no more

  stream::EncodedPacket layout_;
  std::uint64_t layout_epoch_ = 0;
  Manifest manifest_, coming_;
  std::int64_t manifest_ns_ = 0, manifest_wanted_ns_ = 0, manifest_asked_ns_ = 0;
  Found binary_, json_;
};

}  // namespace splatbus::gateway
