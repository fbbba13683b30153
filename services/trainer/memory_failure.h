#pragma once

#include <exception>
#include <functional>
#include <stdexcept>
#include <utility>

#include "bus/subscriber.h"

namespace splatbus::trainer {

/// This process's memory or its device has failed, and no message is to blame: the process ends, and the one that is
/// started in its place adopts the model.
class MemoryFailure : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Runs what only allocates and copies, so that whatever it throws is a MemoryFailure.
template <class Work>
decltype(auto) in_own_memory(Work&& work) {
  try {
    return std::forward<Work>(work)();
  } catch (const std::exception& error) {
    throw MemoryFailure(error.what());
  }
}

/// bus::guarded() that lets a MemoryFailure pass: a message that lies is logged and left out.
inline void guard_message(const bus::Message& message, const std::function<void()>& handle) {
  std::exception_ptr failure;
  bus::guarded(message, [&] {
    try {
      handle();
    } catch (const MemoryFailure&) {
      failure = std::current_exception();
    }
  });
  if (failure) std::rethrow_exception(failure);
}

}  // namespace splatbus::trainer
