#include "store_fuse.h"

#include <signal.h>
#include <sys/mman.h>
#include <ucontext.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cstdlib>
#include <fstream>
#include <sstream>

#ifndef __x86_64__
#error "it steps by the trap flag of x86-64"
#endif

namespace splatbus::chaos {
namespace {

constexpr std::uintptr_t kPageBytes = 4096;
constexpr greg_t kTrapFlag = 0x100;

struct Range {
  std::uintptr_t begin = 0, end = 0;
};
std::array<Range, 256> ranges;
std::size_t range_count = 0;
std::atomic<std::uint64_t> stores = 0;
std::uint64_t deadly = 0;
std::size_t one_of = 1;

/// That the instruction under way writes to: it may reach over an edge.
thread_local std::array<std::uintptr_t, 4> opened{};
thread_local std::size_t opened_count = 0;

void protect(std::uintptr_t at, std::size_t bytes, int protection) {
  // What else could be done within a signal handler?
  if (::mprotect(reinterpret_cast<void*>(at), bytes, protection) != 0) std::abort();
}

bool is_watched(std::uintptr_t at) {
  for (std::size_t i = 0; i < range_count; ++i) {
    if (at >= ranges[i].begin && at < ranges[i].end) return (at - ranges[i].begin) / kPageBytes % one_of == 0;
  }
  return false;
}

void protect_all(std::size_t count, int protection) {
  for (std::size_t i = 0; i < count; ++i) {
    if (one_of == 1) protect(ranges[i].begin, ranges[i].end - ranges[i].begin, protection);
    for (std::uintptr_t at = ranges[i].begin; one_of > 1 && at < ranges[i].end; at += one_of * kPageBytes) {
      protect(at, kPageBytes, protection);
    }
  }
}

void on_store(int, siginfo_t* info, void* context) {
  const auto at = reinterpret_cast<std::uintptr_t>(info->si_addr);
  if (!is_watched(at) || opened_count == opened.size()) {
    ::signal(SIGSEGV, SIG_DFL);  // it comes again, and is what it was
    return;
  }
  if (opened_count == 0 && ++stores == deadly) ::kill(::getpid(), SIGKILL);
  opened[opened_count++] = at & ~(kPageBytes - 1);
  protect(opened[opened_count - 1], kPageBytes, PROT_READ | PROT_WRITE);
  static_cast<ucontext_t*>(context)->uc_mcontext.gregs[REG_EFL] |= kTrapFlag;
}

void on_step(int, siginfo_t*, void* context) {
  for (; opened_count > 0; --opened_count) {
    if (is_watched(opened[opened_count - 1])) protect(opened[opened_count - 1], kPageBytes, PROT_READ);
  }
  static_cast<ucontext_t*>(context)->uc_mcontext.gregs[REG_EFL] &= ~kTrapFlag;
}

void handle(int signal, void (*handler)(int, siginfo_t*, void*)) {
  struct sigaction action {};
  action.sa_sigaction = handler;
  action.sa_flags = SA_SIGINFO;
  ::sigaction(signal, &action, nullptr);
}

}  // namespace

void arm_store_fuse(const std::string& name, std::uint64_t store, std::size_t every) {
  handle(SIGSEGV, on_store);
  handle(SIGTRAP, on_step);
  deadly = store;
  one_of = every;
  stores = 0;
  std::ifstream maps("/proc/self/maps");
  std::size_t found = 0;
  for (std::string line; std::getline(maps, line) && found < ranges.size();) {
    const std::size_t memfd = line.find("/memfd:");
    if (memfd == std::string::npos || line.find(name, memfd) == std::string::npos) continue;
    if (line.find(" rw-s ") == std::string::npos) continue;
    std::istringstream text(line);
    char dash = 0;
    text >> std::hex >> ranges[found].begin >> dash >> ranges[found].end;
    ++found;
  }
  range_count = found;
  protect_all(found, PROT_READ);
}

std::uint64_t disarm_store_fuse() {
  const std::size_t count = range_count;
  range_count = 0;
  protect_all(count, PROT_READ | PROT_WRITE);
  return stores;
}

}  // namespace splatbus::chaos
