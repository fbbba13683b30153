#include "bus/bind.h"

#include <fmt/format.h>

#include <cerrno>
#include <chrono>
#include <system_error>
#include <thread>

#include "bus/permanent_error.h"

namespace splatbus::bus {

void bind_patiently(const std::string& what, const std::function<int()>& attempt) {
  using namespace std::chrono_literals;
  const auto end = std::chrono::steady_clock::now() + 2s;
  int error = attempt();
  while (error == EADDRINUSE && std::chrono::steady_clock::now() < end) {
    std::this_thread::sleep_for(50ms);
    error = attempt();
  }
  if (error == 0) return;
  const std::string text = fmt::format("{}: {}", what, std::generic_category().message(error));
  if (error == EADDRINUSE) throw PermanentError(text);
  throw Error(text);
}

}  // namespace splatbus::bus
