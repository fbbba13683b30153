#include "network_link.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sched.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <utility>

#include "bus/clock.h"
#include "bus/file_descriptor.h"
#include "child_process.h"
#include "tcp_relay.h"

namespace splatbus::cli {

namespace {

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kAnnounceNs = kSecond / 2;  // a cut, before it begins

/// Where a program of the system lies; throws std::runtime_error.
std::filesystem::path find_tool(const std::string& name) {
  for (const char* folder : {"/usr/sbin", "/sbin", "/usr/bin", "/bin"}) {
    if (std::filesystem::path path = std::filesystem::path(folder) / name; std::filesystem::exists(path)) {
      return path;
    }
  }
  throw std::runtime_error(fmt::format("there is no program '{}'", name));
}

/// Throws std::runtime_error with what it said where it fails.
void run_tool(const std::vector<std::string>& command) {
  ChildProcess child(find_tool(command.front()), {command.begin() + 1, command.end()}, {});
  std::optional<ExitStatus> exit;
  while (!(exit = child.poll_exit())) {
    pollfd ended{child.exit_fd(), POLLIN, 0};
    ::poll(&ended, 1, -1);
  }
  if (exit->success()) return;
  const std::vector<std::string> lines = child.read_lines(true);
  throw std::runtime_error(
      fmt::format("{} {}: {}", command.front(), command[1], lines.empty() ? exit->text() : lines.front()));
}

/// The calling thread is in a network namespace of its own while this lives; so is what it starts meanwhile.
class OwnNetworkNamespace {
 public:
  OwnNetworkNamespace() : before_(::open("/proc/thread-self/ns/net", O_RDONLY | O_CLOEXEC)) {
    if (!before_.valid() || ::unshare(CLONE_NEWNET) != 0) {
      throw std::runtime_error(fmt::format("no network namespace: {}", std::strerror(errno)));
    }
  }
  ~OwnNetworkNamespace() { ::setns(before_.get(), CLONE_NEWNET); }
  OwnNetworkNamespace(const OwnNetworkNamespace&) = delete;
  OwnNetworkNamespace& operator=(const OwnNetworkNamespace&) = delete;

 private:
  bus::FileDescriptor before_;
};

class NetemLink : public NetworkLink {
 public:
  NetemLink(const LinkShape& shape, std::uint16_t streamer_port) : shape_(shape), port_(streamer_port) {
    for (const std::vector<std::string>& command : netem_setup(shape)) run_tool(command);
  }

  [[nodiscard]] std::string endpoint() const override { return fmt::format("tcp://127.0.0.1:{}", port_); }
  [[nodiscard]] std::string text() const override {
    return fmt::format("netem in a network namespace: {}", shape_.text());
  }
  LinkCut cut(double seconds) override {
    const std::int64_t from_ns = bus::now_ns();
    run_tool(netem_command("change", shape_, true));
    cut_ = {.from_ns = from_ns, .to_ns = from_ns + static_cast<std::int64_t>(seconds * 1e9)};
    return *cut_;
  }
  void maintain() override {
    if (!cut_ || cut_->contains(bus::now_ns())) return;
    cut_.reset();
    run_tool(netem_command("change", shape_, false));
  }

 private:
  OwnNetworkNamespace namespace_;
  LinkShape shape_;
  std::uint16_t port_;
  std::optional<LinkCut> cut_;
};

class RelayLink : public NetworkLink {
 public:
  RelayLink(const LinkShape& shape, std::uint16_t streamer_port, std::string reason)
      : shape_(shape), reason_(std::move(reason)), relay_(streamer_port, shape) {}

  [[nodiscard]] std::string endpoint() const override { return fmt::format("tcp://127.0.0.1:{}", relay_.port()); }
  [[nodiscard]] std::string text() const override {
    return fmt::format("relay{}: {}", reason_.empty() ? "" : fmt::format(" ({})", reason_), shape_.text());
  }
  LinkCut cut(double seconds) override {
    const std::int64_t from_ns = bus::now_ns() + kAnnounceNs;
    const LinkCut cut{.from_ns = from_ns, .to_ns = from_ns + static_cast<std::int64_t>(seconds * 1e9)};
    relay_.cut(cut);
    return cut;
  }

 private:
  LinkShape shape_;
  std::string reason_;
  TcpRelay relay_;
};

}  // namespace

std::vector<std::string> netem_command(const char* verb, const LinkShape& shape, bool cut) {
  std::vector<std::string> command{"tc", "qdisc", verb, "dev", "lo", "root", "netem", "limit", "2000"};
  if (shape.round_trip_ms > 0) {
    command.insert(command.end(), {"delay", fmt::format("{:g}ms", shape.round_trip_ms / 2)});
  }
  const double loss = cut ? 1 : shape.loss;
  if (loss > 0 || std::string(verb) == "change") {
    command.insert(command.end(), {"loss", fmt::format("{:g}%", loss * 100)});
  }
  if (shape.mbps > 0) command.insert(command.end(), {"rate", fmt::format("{:g}mbit", shape.mbps)});
  return command;
}

std::vector<std::vector<std::string>> netem_setup(const LinkShape& shape) {
  return {{"ip", "link", "set", "dev", "lo", "mtu", "1500", "gso_max_segs", "1", "up"},
          netem_command("add", shape, false)};
}

std::unique_ptr<NetworkLink> make_link(LinkKind kind, const LinkShape& shape, std::uint16_t streamer_port) {
  std::string reason;
  if (kind != LinkKind::Relay) {
    try {
      return std::make_unique<NetemLink>(shape, streamer_port);
    } catch (const std::runtime_error& error) {
      if (kind == LinkKind::Netem) throw;
      reason = error.what();
    }
  }
  return std::make_unique<RelayLink>(shape, streamer_port, reason);
}

}  // namespace splatbus::cli
