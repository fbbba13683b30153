#include "bus/slab_client.h"

#include <fmt/format.h>
#include <poll.h>
#include <spdlog/spdlog.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include "bus/error.h"
#include "bus/private_folder.h"

namespace splatbus::bus {
namespace {

constexpr std::chrono::milliseconds first_pause{50};
constexpr std::chrono::milliseconds longest_pause{1000};
constexpr timeval answer_timeout{2, 0};
constexpr std::chrono::milliseconds claim_pause{5};
constexpr std::chrono::milliseconds look_timeout{100};

FileDescriptor connect_to(const std::string& path) {
  FileDescriptor socket(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0));
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (!socket.valid() || path.size() >= sizeof(address.sun_path)) return {};
  std::memcpy(address.sun_path, path.c_str(), path.size());
  // Before connect(), which waits for room in the queue of a broker that accepts nobody.
  ::setsockopt(socket.get(), SOL_SOCKET, SO_SNDTIMEO, &answer_timeout, sizeof(answer_timeout));
  ::setsockopt(socket.get(), SOL_SOCKET, SO_RCVTIMEO, &answer_timeout, sizeof(answer_timeout));
  if (::connect(socket.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0) return {};
  try {
    require_own_peer(socket.get(), path);
  } catch (const Error& error) {
    spdlog::error("{}", error.what());
    return {};
  }
  return socket;
}

}  // namespace

SlabClient::SlabClient(std::string socket_path)
    : socket_path_(std::move(socket_path)), wake_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  if (!wake_.valid()) throw Error("cannot make an eventfd");
  connect();
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

SlabClient::~SlabClient() {
  thread_.request_stop();
  ::eventfd_write(wake_.get(), 1);
  thread_.join();
}

void SlabClient::look() {
  ++looks_wanted_;
  ::eventfd_write(wake_.get(), 1);
}

bool SlabClient::has_registered_all() {
  const std::unique_lock lock(mutex_, std::try_to_lock);
  if (!lock.owns_lock()) return false;
  return is_live() || std::ranges::all_of(own_, [](const auto& entry) { return entry.second.expired(); });
}

// A connection to a broker that has gone is none, though the thread may not have seen that yet.
bool SlabClient::is_live() const {
  if (!connected_) return false;
  pollfd item{socket_.get(), POLLRDHUP, 0};
  return ::poll(&item, 1, 0) == 0;
}

bool SlabClient::add(const std::shared_ptr<Slab>& slab, std::chrono::milliseconds timeout) {
  const auto deadline = std::chrono::steady_clock::now() + timeout;
  std::unique_lock lock(mutex_);
  while (connected_changed_.wait_until(lock, deadline, [this] { return connected_; })) {
    const auto answer = ask(SlabOperation::Register, slab->descriptor(), slab->control_fd(), slab->data_fd());
    if (!answer) continue;  // the broker went meanwhile
    if (answer->status != SlabStatus::Ok) {
      throw Error(fmt::format("slab '{}' was refused: {}", slab->name(), answer->text));
    }
    own_[slab->name()] = slab;
    return true;
  }
  return false;
}

void SlabClient::keep(const std::shared_ptr<Slab>& slab) {
  const std::scoped_lock lock(mutex_);
  own_[slab->name()] = slab;
}

void SlabClient::drop(const std::string& name) {
  const std::scoped_lock lock(mutex_);
  own_.erase(name);
  SlabDescriptor descriptor;
  descriptor.name = name;
  if (connected_) (void)ask(SlabOperation::Release, descriptor, -1, -1);
}

void SlabClient::claim(const std::string& source, std::chrono::milliseconds timeout) {
  const auto deadline = std::chrono::steady_clock::now() + timeout;
  std::unique_lock lock(mutex_);
  while (true) {
    const auto left = std::max(deadline - std::chrono::steady_clock::now(), std::chrono::steady_clock::duration(0));
    claimed_.insert(source);  // where no broker is yet: when it comes
    if (!connected_changed_.wait_for(lock, left, [this] { return connected_; })) return;
    const auto answer = ask_for_lease(source);
    if (!answer) continue;
    if (answer->status != SlabStatus::Refused) return;
    claimed_.erase(source);
    if (std::chrono::steady_clock::now() >= deadline) throw Error(answer->text);
    connected_changed_.wait_for(lock, claim_pause, [] { return false; });
  }
}

std::optional<SlabPacket> SlabClient::ask_for_lease(const std::string& source) {
  SlabDescriptor descriptor;
  descriptor.name = source + "/lease";  // of which there is none: the question alone takes it
  return ask(SlabOperation::OpenByName, descriptor, -1, -1);
}

std::optional<SlabPacket> SlabClient::open(std::uint64_t id, const std::string& name,
                                           std::chrono::milliseconds timeout) {
  std::unique_lock lock(mutex_);
  if (!is_live()) {
    // Who asks may have heard of the slab from a broker that has just come back.
    look();
    const std::uint64_t looked = looks_wanted_;
    connected_changed_.wait_for(lock, look_timeout, [&] { return is_live() || looks_done_ >= looked; });
  }
  if (!connected_changed_.wait_for(lock, timeout, [this] { return connected_; })) return std::nullopt;
  SlabDescriptor descriptor;
  descriptor.id = id;
  descriptor.name = name;
  auto answer = ask(name.empty() ? SlabOperation::Open : SlabOperation::OpenByName, descriptor, -1, -1);
  if (answer && answer->status == SlabStatus::Refused) {
    throw Error(fmt::format("slab '{}' was refused: {}", name, answer->text));
  }
  if (!answer || answer->status != SlabStatus::Ok) return std::nullopt;
  return answer;
}

std::optional<SlabPacket> SlabClient::ask(SlabOperation operation, const SlabDescriptor& descriptor, int control_fd,
                                          int data_fd) {
  try {
    SlabPacket request;
    request.operation = operation;
    request.descriptor = descriptor;
    send_slab_packet(socket_.get(), request, control_fd, data_fd);
    auto answer = receive_slab_packet(socket_.get());
    if (answer && answer->operation == SlabOperation::Answer) return answer;
  } catch (const Error& error) {
    spdlog::warn("{}", error.what());
  }
  // Whatever went wrong, an answer that comes late must not be taken for the next question's.
  connected_ = false;
  ::shutdown(socket_.get(), SHUT_RDWR);
  return std::nullopt;
}

bool SlabClient::connect() {
  const std::uint64_t look = looks_wanted_;
  auto socket = connect_to(socket_path_);
  const std::scoped_lock lock(mutex_);
  looks_done_ = look;
  if (socket.valid()) {
    socket_ = std::move(socket);
    connected_ = true;
    register_all();
  }
  connected_changed_.notify_all();
  return connected_;
}

void SlabClient::register_all() {
  for (const auto& source : claimed_) {
    if (!connected_) return;
    const auto answer = ask_for_lease(source);
    if (answer && answer->status == SlabStatus::Refused) spdlog::error("{}", answer->text);
  }
  for (auto it = own_.begin(); it != own_.end() && connected_;) {
    const auto slab = it->second.lock();
    if (slab == nullptr) {
      it = own_.erase(it);
      continue;
    }
    const auto answer = ask(SlabOperation::Register, slab->descriptor(), slab->control_fd(), slab->data_fd());
    if (answer && answer->status != SlabStatus::Ok) {
      spdlog::error("slab '{}' was refused after the broker came back: {}", slab->name(), answer->text);
    }
    ++it;
  }
}

bool SlabClient::connected() {
  const std::scoped_lock lock(mutex_);
  return connected_;
}

void SlabClient::take_wake() const {
  eventfd_t ignored = 0;
  ::eventfd_read(wake_.get(), &ignored);
}

void SlabClient::run(const std::stop_token& stop) {
  auto pause = first_pause;
  while (!stop.stop_requested()) {
    if (!connected() && !connect()) {
      pollfd wait{wake_.get(), POLLIN, 0};
      const bool woken = ::poll(&wait, 1, static_cast<int>(pause.count())) > 0;
      take_wake();
      pause = woken ? first_pause : std::min(pause * 2, longest_pause);
      continue;
    }
    pause = first_pause;
    // Answers are read by those who asked; here only the end of the connection counts.
    pollfd fds[2] = {{socket_.get(), POLLRDHUP, 0}, {wake_.get(), POLLIN, 0}};
    ::poll(fds, 2, -1);
    take_wake();
    if (fds[0].revents == 0) continue;
    const std::scoped_lock lock(mutex_);
    connected_ = false;
    socket_.reset();
  }
}

}  // namespace splatbus::bus
