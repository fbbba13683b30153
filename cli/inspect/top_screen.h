#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace splatbus::cli {

/// The whole terminal, by ncurses, given back as it was when this goes. One at a time, one thread.
class TopScreen {
 public:
  TopScreen();  ///< throws std::runtime_error where standard input and output are not a terminal to draw on
  ~TopScreen();
  TopScreen(const TopScreen&) = delete;
  TopScreen& operator=(const TopScreen&) = delete;

  /// The first line and lines that begin with a word in capitals stand out; what does not fit is cut, and below can be
  /// scrolled to. `foot` is the last line.
  void draw(const std::vector<std::string>& lines, const std::string& foot);
  /// A letter that was typed, nullopt when there is none. Scrolls by itself; a change of size draws anew.
  [[nodiscard]] std::optional<char> key();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace splatbus::cli
