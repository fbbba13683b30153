#pragma once

#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include "child_process.h"
#include "supervised_run.h"

namespace splatbus::cli {

/// `count` viewers in this process, on one thread: they hold replicas of all that comes and draw nothing. Says on
/// standard output once a second how many of them have everything. Until a signal says stop.
void run_light_followers(const std::string& endpoint, std::size_t count, const StopSignals& signals);

/// So many of them, in few processes that go with this. Made and used on one thread.
class LightFollowers {
 public:
  explicit LightFollowers(std::string endpoint) : endpoint_(std::move(endpoint)) {}

  /// Starts those that are missing. Throws std::runtime_error.
  void grow_to(std::size_t count);
  /// How many have everything, as they last said. Throws std::runtime_error when a process of them has ended.
  [[nodiscard]] std::size_t whole();
  [[nodiscard]] std::size_t count() const { return count_; }

 private:
  struct Group {
    ChildProcess process;
    std::size_t whole = 0;
  };
  std::string endpoint_;
  std::vector<Group> groups_;
  std::size_t count_ = 0;
};

}  // namespace splatbus::cli
