#include "top_screen.h"

#define NCURSES_NOMACROS 1
#include <curses.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <clocale>
#include <stdexcept>

namespace splatbus::cli {

struct TopScreen::Impl {
  SCREEN* screen = nullptr;
  std::vector<std::string> lines;
  std::string foot;
  std::size_t first = 0;  ///< line at the top

  void draw();
};

TopScreen::TopScreen() : impl_(std::make_unique<Impl>()) {
  std::setlocale(LC_CTYPE, "");
  // initscr() would end the program where this fails.
  if (::isatty(STDIN_FILENO) == 1 && ::isatty(STDOUT_FILENO) == 1) impl_->screen = ::newterm(nullptr, stdout, stdin);
  if (impl_->screen == nullptr) {
    throw std::runtime_error("top cannot draw on this terminal: use --once or --json, or set TERM");
  }
  ::cbreak();
  ::noecho();
  ::keypad(stdscr, true);
  ::nodelay(stdscr, true);
  ::curs_set(0);
}

TopScreen::~TopScreen() {
  ::endwin();
  ::delscreen(impl_->screen);
}

void TopScreen::draw(const std::vector<std::string>& lines, const std::string& foot) {
  impl_->lines = lines;
  impl_->foot = foot;
  impl_->draw();
}

void TopScreen::Impl::draw() {
  const int rows = getmaxy(stdscr), columns = getmaxx(stdscr);
  const auto shown = static_cast<std::size_t>(std::max(0, rows - 1));
  first = std::min(first, lines.size() > shown ? lines.size() - shown : 0);
  ::erase();
  for (std::size_t row = 0; row < shown && first + row < lines.size(); ++row) {
    const std::string& line = lines[first + row];
    const bool head = line.size() > 1 && std::isupper(static_cast<unsigned char>(line[0])) != 0 &&
                      std::isupper(static_cast<unsigned char>(line[1])) != 0;
    ::attrset(static_cast<int>(head || first + row == 0 ? A_BOLD : A_NORMAL));
    ::mvaddnstr(static_cast<int>(row), 0, line.c_str(), columns);
  }
  ::attrset(static_cast<int>(A_REVERSE));
  if (rows > 0) ::mvaddnstr(rows - 1, 0, foot.c_str(), columns);
  ::attrset(static_cast<int>(A_NORMAL));
  ::refresh();
}

std::optional<char> TopScreen::key() {
  for (int key = ::wgetch(stdscr); key != ERR; key = ::wgetch(stdscr)) {
    const auto page = static_cast<std::size_t>(std::max(1, getmaxy(stdscr) - 2));
    std::size_t& first = impl_->first;
    if (key == KEY_DOWN) {
      ++first;
    } else if (key == KEY_UP) {
      first -= std::min<std::size_t>(first, 1);
    } else if (key == KEY_NPAGE) {
      first += page;
    } else if (key == KEY_PPAGE) {
      first -= std::min(first, page);
    } else if (key != KEY_RESIZE) {
      if (key >= ' ' && key < 127) return static_cast<char>(key);
      continue;
    }
    impl_->draw();
  }
  return {};
}

}  // namespace splatbus::cli
