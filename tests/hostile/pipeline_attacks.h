#pragma once

#include <unistd.h>

#include <atomic>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

namespace splatbus::hostile {

/// The doors that attackers come by: below those that the kernel gives to whoever connects.
struct Ports {
  int bus = 10000 + ::getpid() % 7000 * 3;
  [[nodiscard]] std::string writers() const { return "tcp://127.0.0.1:" + std::to_string(bus); }
  [[nodiscard]] std::string readers() const { return "tcp://127.0.0.1:" + std::to_string(bus + 1); }
  [[nodiscard]] std::string stream() const { return "tcp://127.0.0.1:" + std::to_string(bus + 2); }
};

/// One thing done again and again on a thread of its own, `per_s` times a second. What goes wrong with it is what was
/// wanted.
class Attack {
 public:
  Attack(std::string name, double per_s, std::function<void()> once);
  [[nodiscard]] const std::string& name() const { return name_; }
  [[nodiscard]] int done() const { return done_; }

 private:
  const std::string name_;
  std::atomic<int> done_ = 0;
  std::jthread thread_;
};

/// A dozen, which go on until they are let go. Each takes little processor time.
[[nodiscard]] std::vector<std::unique_ptr<Attack>> all_attacks(const Ports& ports);

}  // namespace splatbus::hostile
