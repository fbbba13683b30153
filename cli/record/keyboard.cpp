#include "keyboard.h"

#include <poll.h>
#include <signal.h>
#include <termios.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <utility>

namespace splatbus::cli {

namespace {

constexpr std::chrono::milliseconds kTurn(50);

// A signal's handler is given nothing but these.
termios kept_modes;
volatile sig_atomic_t modes_changed = 0;
std::atomic<pid_t> taking_thread = 0;  // its number, while there is one

bool is_in_foreground() {
  return ::tcgetpgrp(STDIN_FILENO) == ::getpgrp();
}

void give_back() {
  if (modes_changed != 0) ::tcsetattr(STDIN_FILENO, TCSANOW, &kept_modes);
  modes_changed = 0;
}

/// In the thread that takes the terminal over, wherever the signal came: another one would give it back and have it
/// taken again before the program has ended.
void give_back_and_end(int signal) {
  const pid_t taker = taking_thread;
  if (taker != 0 && taker != ::gettid() && ::tgkill(::getpid(), taker, signal) == 0) return;
  give_back();
  ::signal(signal, SIG_DFL);
  ::raise(signal);
}

/// A shell that has stopped the program has set the terminal as it likes it, so that this is asked again and again.
void take_over() {
  termios now{};
  if (::tcgetattr(STDIN_FILENO, &now) != 0 || (now.c_lflag & ICANON) == 0) return;
  if (modes_changed == 0) kept_modes = now;
  now.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO);
  now.c_cc[VMIN] = 1;
  now.c_cc[VTIME] = 0;
  modes_changed = 1;
  ::tcsetattr(STDIN_FILENO, TCSANOW, &now);
}

}  // namespace

bool Keyboard::is_there() {
  return ::isatty(STDIN_FILENO) == 1 && is_in_foreground();
}

Keyboard::Keyboard(std::function<void(char)> typed) : typed_(std::move(typed)) {
  struct sigaction action {};
  action.sa_handler = give_back_and_end;
  ::sigaction(SIGQUIT, &action, nullptr);
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

Keyboard::~Keyboard() {
  thread_.request_stop();
  thread_.join();
  ::signal(SIGQUIT, SIG_DFL);
  if (is_in_foreground()) give_back();
}

void Keyboard::run(const std::stop_token& stop) {
  taking_thread = ::gettid();
  read_keys(stop);
  taking_thread = 0;
}

void Keyboard::read_keys(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    // Who reads a terminal, or sets it, from the background is stopped.
    if (!is_in_foreground()) {
      std::this_thread::sleep_for(kTurn);
      continue;
    }
    take_over();
    pollfd item{.fd = STDIN_FILENO, .events = POLLIN, .revents = 0};
    if (::poll(&item, 1, static_cast<int>(kTurn.count())) <= 0) continue;
    std::array<char, 64> bytes{};
    const ssize_t got = ::read(STDIN_FILENO, bytes.data(), bytes.size());
    if (got < 0 && errno == EINTR) continue;
    if (got <= 0) return;  // the terminal has gone
    for (ssize_t i = 0; i < got; ++i) take(bytes[static_cast<std::size_t>(i)]);
  }
}

// Arrows and the like are ESC [ or ESC O, parameters, and a letter.
void Keyboard::take(char byte) {
  constexpr char kEscape = '\x1b';
  if (byte == kEscape || (sequence_.size() == 1 && (byte == '[' || byte == 'O'))) {
    sequence_ = byte == kEscape ? std::string(1, byte) : sequence_ + byte;
    return;
  }
  if (sequence_.size() >= 2) {
    if (byte >= '0' && byte <= '?') return;
    sequence_.clear();
    if (byte == 'C') typed_(kRight);
    return;
  }
  sequence_.clear();
  if (byte >= ' ' && byte < 127) typed_(byte);
}

}  // namespace splatbus::cli
