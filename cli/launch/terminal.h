#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <vector>

namespace splatbus::cli {

/// Prints lines with the name of the process that wrote them in front, in a colour of its own on a terminal.
class PrefixedOutput {
 public:
  PrefixedOutput(const std::vector<std::string>& names, bool color);
  /// `own`: a line about the process, not from it.
  [[nodiscard]] std::string format(const std::string& name, const std::string& line, bool own) const;
  /// To standard output, after the time of day.
  void print(const std::string& name, const std::string& line, bool own) const;

 private:
  std::size_t width_ = 0;
  bool color_;
  std::map<std::string, int> colors_;
};

/// One line that is written over and over on a terminal, and line by line elsewhere. To standard error.
class ProgressLine {
 public:
  ProgressLine();
  ~ProgressLine();
  ProgressLine(const ProgressLine&) = delete;
  ProgressLine& operator=(const ProgressLine&) = delete;
  void show(const std::string& text);
  void finish();  ///< keeps the last text

 private:
  bool terminal_;
  bool open_ = false;
};

[[nodiscard]] bool is_terminal(int fd);
/// On a terminal, unless NO_COLOR says otherwise.
[[nodiscard]] bool wants_color(int fd);

}  // namespace splatbus::cli
