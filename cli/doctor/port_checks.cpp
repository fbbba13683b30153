#include <arpa/inet.h>
#include <dirent.h>
#include <fmt/format.h>
#include <netdb.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <fstream>
#include <memory>
#include <set>
#include <sstream>

#include "bus/file_descriptor.h"
#include "checks.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;

/// Inodes of the sockets that listen on the port.
std::set<std::string> listening_inodes(std::uint16_t port) {
  std::set<std::string> inodes;
  for (const char* table : {"/proc/net/tcp", "/proc/net/tcp6"}) {
    std::ifstream file(table);
    std::string line;
    std::getline(file, line);
    while (std::getline(file, line)) {
      std::istringstream fields(line);
      std::string slot, local, remote, state, skipped, inode;
      fields >> slot >> local >> remote >> state >> skipped >> skipped >> skipped >> skipped >> skipped >> inode;
      constexpr const char* kListen = "0A";
      if (state == kListen && local.ends_with(fmt::format(":{:04X}", port))) inodes.insert(inode);
    }
  }
  return inodes;
}

bool has_socket(const fs::path& process, const std::set<std::string>& inodes) {
  std::error_code error;
  for (fs::directory_iterator fd(process / "fd", error), end; !error && fd != end; fd.increment(error)) {
    std::error_code unreadable;
    const std::string target = fs::read_symlink(fd->path(), unreadable).string();
    if (target.starts_with("socket:[") && inodes.contains(target.substr(8, target.size() - 9))) return true;
  }
  return false;
}

std::string name_of(pid_t pid) {
  std::ifstream file(fmt::format("/proc/{}/comm", pid));
  std::string name;
  std::getline(file, name);
  return name;
}

}  // namespace

pid_t listener_of(std::uint16_t port) {
  const auto inodes = listening_inodes(port);
  if (inodes.empty()) return 0;
  std::error_code error;
  for (fs::directory_iterator process("/proc", error), end; !error && process != end; process.increment(error)) {
    const std::string name = process->path().filename();
    if (name.find_first_not_of("0123456789") != std::string::npos) continue;
    if (has_socket(process->path(), inodes)) return std::stoi(name);
  }
  return 0;
}

Check check_port(const std::string& host, std::uint16_t port, const std::string& who) {
  Check check{.name = fmt::format("port {}", port), .found = fmt::format("free, for {}", who)};
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_PASSIVE;
  addrinfo* found = nullptr;
  const char* const name = host.empty() || host == "*" ? nullptr : host.c_str();
  if (const int error = ::getaddrinfo(name, std::to_string(port).c_str(), &hints, &found); error != 0) {
    return {check.name, Verdict::Fail, fmt::format("{}: {}", host, ::gai_strerror(error)),
            fmt::format("correct the address of {}", who)};
  }
  const std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> owner(found, &::freeaddrinfo);
  const bus::FileDescriptor socket(::socket(found->ai_family, SOCK_STREAM | SOCK_CLOEXEC, 0));
  const int reuse = 1;  // as servers do: connections that were closed a moment ago are no obstacle
  ::setsockopt(socket.get(), SOL_SOCKET, SO_REUSEADDR, &reuse, sizeof reuse);
  if (::bind(socket.get(), found->ai_addr, found->ai_addrlen) == 0) return check;
  const int reason = errno;
  check.verdict = Verdict::Fail;
  if (reason != EADDRINUSE) {
    check.found = fmt::format("{} cannot have it: {}", who, std::strerror(reason));
    check.advice = reason == EACCES ? "choose a port above 1023" : "choose an address of this machine";
    return check;
  }
  const pid_t pid = listener_of(port);
  const std::string program = pid == 0 ? std::string() : name_of(pid);
  const std::string taken =
      pid == 0 ? std::string("taken by another user's program") : fmt::format("taken by {} (process {})", program, pid);
  // The kernel keeps 15 characters of a program's name.
  if (program.starts_with("splatbus-")) return {check.name, Verdict::Ok, taken, {}};
  check.found = taken;
  check.advice = fmt::format("end it, or give {} another port in the launch file", who);
  return check;
}

}  // namespace splatbus::cli
