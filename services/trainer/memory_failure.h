#pragma once

#include <exception>
#include <stdexcept>
#include <utility>

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

}  // namespace splatbus::trainer
