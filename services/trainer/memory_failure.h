#pragma once

#include <exception>
#include <string>
#include <utility>

namespace splatbus::trainer {

/// This process's memory or its device has failed: the process ends, and the one that is started in its place adopts
/// the model. Not a std::exception, so that whatever guards against messages that lie lets it pass.
class MemoryFailure {
 public:
  explicit MemoryFailure(std::string what) : what_(std::move(what)) {}
  [[nodiscard]] const std::string& what() const { return what_; }

 private:
  std::string what_;
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
