#pragma once

#include <functional>
#include <string>
#include <thread>

namespace splatbus::cli {

/// Keys that are typed at the terminal of standard input, each at once and unseen, for as long as this is there; then,
/// and when the program is ended by SIGQUIT, the terminal is as it was. While the program is in the background it
/// leaves the terminal alone. One at a time.
class Keyboard {
 public:
  static constexpr char kRight = '\x01';  ///< the right arrow

  /// `typed` is called in a thread of its own. Other keys without a character are left out.
  explicit Keyboard(std::function<void(char key)> typed);
  ~Keyboard();
  Keyboard(const Keyboard&) = delete;
  Keyboard& operator=(const Keyboard&) = delete;

  /// Whether standard input is a terminal, and this program in its foreground.
  [[nodiscard]] static bool is_there();

 private:
  void run(const std::stop_token& stop);
  void read_keys(const std::stop_token& stop);
  void take(char byte);

  const std::function<void(char)> typed_;
  std::string sequence_;  ///< of a key that says more than one byte, so far
  std::jthread thread_;
};

}  // namespace splatbus::cli
