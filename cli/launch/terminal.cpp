#include "terminal.h"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <cstdlib>

namespace splatbus::cli {

namespace {

constexpr std::array kColors{36, 32, 33, 35, 34, 96, 92, 93, 95, 94};

std::size_t terminal_width() {
  winsize size{};
  return ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0 ? size.ws_col : 80;
}

}  // namespace

bool is_terminal(int fd) {
  return isatty(fd) != 0;
}

bool wants_color(int fd) {
  const char* const refused = std::getenv("NO_COLOR");
  return is_terminal(fd) && (refused == nullptr || *refused == '\0');
}

PrefixedOutput::PrefixedOutput(const std::vector<std::string>& names, bool color) : color_(color) {
  for (const std::string& name : names) {
    width_ = std::max(width_, name.size());
    colors_.emplace(name, kColors[colors_.size() % kColors.size()]);
  }
}

std::string PrefixedOutput::format(const std::string& name, const std::string& line, bool own) const {
  const char* separator = own ? "*" : "|";
  if (!color_) return fmt::format("{:<{}} {} {}", name, width_, separator, line);
  const auto color = colors_.find(name);
  return fmt::format("\x1b[{}m{:<{}} {}\x1b[0m {}", color == colors_.end() ? 37 : color->second, name, width_,
                     separator, line);
}

void PrefixedOutput::print(const std::string& name, const std::string& line, bool own) const {
  const auto now = std::chrono::floor<std::chrono::milliseconds>(std::chrono::system_clock::now());
  const std::string text =
      fmt::format("{:%H:%M:%S}.{:03} {}\n", fmt::localtime(std::chrono::system_clock::to_time_t(now)),
                  now.time_since_epoch().count() % 1000, format(name, line, own));
  std::fwrite(text.data(), 1, text.size(), stdout);
  std::fflush(stdout);
}

ProgressLine::ProgressLine() : terminal_(is_terminal(STDERR_FILENO)) {}

ProgressLine::~ProgressLine() {
  finish();
}

void ProgressLine::show(const std::string& text) {
  if (terminal_) {
    fmt::print(stderr, "\r\x1b[2K{}", text.substr(0, terminal_width() - 1));
    open_ = true;
  } else {
    fmt::print(stderr, "{}\n", text);
  }
  std::fflush(stderr);
}

void ProgressLine::finish() {
  if (open_) fmt::print(stderr, "\n");
  open_ = false;
}

}  // namespace splatbus::cli
