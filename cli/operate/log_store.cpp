#include "log_store.h"

#include <fcntl.h>
#include <fmt/chrono.h>
#include <fmt/format.h>
#include <poll.h>
#include <spdlog/pattern_formatter.h>
#include <spdlog/sinks/rotating_file_sink.h>
#include <sys/inotify.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <chrono>
#include <cstdlib>
#include <set>
#include <stdexcept>
#include <utility>

#include "bus/file_descriptor.h"
#include "log_files.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;

using Sink = spdlog::sinks::rotating_file_sink_st;

constexpr const char* kPattern = "%Y-%m-%dT%H:%M:%S.%fZ %v";

}  // namespace

struct LogStore::Sinks {
  std::map<std::string, std::unique_ptr<Sink>> of_process;
};

fs::path log_folder(const bus::Address& bus) {
  const char* const state = std::getenv("XDG_STATE_HOME");
  const char* const home = std::getenv("HOME");
  fs::path base;
  if (state != nullptr && *state == '/') {
    base = state;
  } else if (home != nullptr && *home == '/') {
    base = fs::path(home) / ".local" / "state";
  } else {
    return {};
  }
  if (!bus.is_local()) return base / "splatbus" / "tcp" / fmt::format("{}:{}", bus.host, bus.port);
  return base / "splatbus" / "ipc" / fs::path(*bus.directory).relative_path();
}

LogStore::LogStore(fs::path folder, std::size_t file_bytes, std::size_t files)
    : folder_(std::move(folder)), file_bytes_(file_bytes), files_(files), sinks_(std::make_unique<Sinks>()) {
  std::error_code error;
  fs::create_directories(folder_, error);
  if (error) throw std::runtime_error(fmt::format("no log files: {}: {}", folder_.string(), error.message()));
}

LogStore::~LogStore() = default;

void LogStore::write(const OutputLine& line) {
  try {
    auto& sink = sinks_->of_process[line.process];
    if (!sink) {
      sink = std::make_unique<Sink>(current_file(folder_, line.process).string(), file_bytes_, files_);
      sink->set_formatter(std::make_unique<spdlog::pattern_formatter>(kPattern, spdlog::pattern_time_type::utc));
    }
    const std::string text = (line.event.empty() ? "| " : "* ") + line.text;
    sink->log({line.process, spdlog::level::info, text});
    sink->flush();
  } catch (const spdlog::spdlog_ex&) {  // the lines are on the terminal, and for those who are attached
  }
}

std::vector<StoredLine> read_logs(const fs::path& folder, const std::vector<std::string>& processes,
                                  const std::string& since, int tail) {
  std::vector<StoredLine> lines;
  for (const std::string& process : processes) {
    read_files(files_of(folder, process), process, {since, tail}, kAllBytes, lines);
  }
  in_order(lines, tail);
  return lines;
}

std::vector<std::string> logged_processes(const fs::path& folder) {
  std::set<std::string> names;
  std::error_code ignored;
  for (const auto& entry : fs::directory_iterator(folder, ignored)) {
    if (entry.path().extension() != ".log") continue;
    std::string name = entry.path().stem();  // "trainer", "trainer.1", "trainer.next", "trainer.next.1"
    const std::size_t dot = name.rfind('.');
    const bool numbered = dot != std::string::npos && dot + 1 < name.size() &&
                          name.find_first_not_of("0123456789", dot + 1) == std::string::npos;
    names.insert(numbered ? name.substr(0, dot) : name);
  }
  return {names.begin(), names.end()};
}

std::string since_time(const std::string& text) {
  if (text.empty() || text.find('T') != std::string::npos) return text;
  static const std::map<std::string, int> kSeconds{{"s", 1}, {"m", 60}, {"h", 3600}, {"d", 86400}};
  double number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  const auto unit = kSeconds.find(std::string(end, text.data() + text.size()));
  if (error != std::errc() || unit == kSeconds.end() || number < 0 || number > 1e6) {
    throw std::runtime_error(fmt::format("--since '{}': expected 90s, 10m, 2h, 1d or 2026-11-23T03:32:00Z", text));
  }
  const auto before = std::chrono::seconds(static_cast<std::int64_t>(number * unit->second));
  const auto then = std::chrono::system_clock::to_time_t(std::chrono::system_clock::now() - before);
  return fmt::format("{:%Y-%m-%dT%H:%M:%S}", fmt::gmtime(then));
}

/// The end of a log file, across its rotations.
class LogFollower::Tail {
 public:
  Tail(fs::path path, std::string process, bool at_end) : path_(std::move(path)), process_(std::move(process)) {
    open();
    struct stat status {};
    if (!at_end || !file_.valid() || fstat(file_.get(), &status) != 0) return;
    first_inode_ = status.st_ino;
    // Whole lines: the rest of one that is being written comes with its end.
    first_byte_ = static_cast<std::uintmax_t>(lseek(file_.get(), last_line_end(status.st_size), SEEK_SET));
  }

  /// What was there before.
  void read_before(const fs::path& folder, const Extent& wanted, std::vector<StoredLine>& lines) const {
    const auto files = files_of(folder, process_);
    const auto first = std::ranges::find_if(files, [&](const fs::path& file) {
      struct stat status {};
      return stat(file.c_str(), &status) == 0 && status.st_ino == first_inode_;
    });
    if (first != files.end()) read_files({first, files.end()}, process_, wanted, first_byte_, lines);
  }

  void pass_new(const std::function<void(const StoredLine&)>& pass) {
    read(pass);
    struct stat there {
    }, ours{};
    if (stat(path_.c_str(), &there) != 0) return;
    if (file_.valid() && fstat(file_.get(), &ours) == 0 && ours.st_ino == there.st_ino) return;
    read(pass);
    open();
    read(pass);
  }

 private:
  void open() {
    file_ = bus::FileDescriptor(::open(path_.c_str(), O_RDONLY | O_CLOEXEC));
    partial_.clear();
  }

  [[nodiscard]] off_t last_line_end(off_t size) const {
    for (char byte = 0; size > 0; --size) {
      if (pread(file_.get(), &byte, 1, size - 1) != 1 || byte == '\n') break;
    }
    return size;
  }

  void read(const std::function<void(const StoredLine&)>& pass) {
    std::array<char, 16384> chunk{};
    for (ssize_t got = 1; file_.valid() && got > 0;) {
      got = ::read(file_.get(), chunk.data(), chunk.size());
      if (got > 0) partial_.append(chunk.data(), static_cast<std::size_t>(got));
    }
    std::size_t begin = 0;
    for (std::size_t end = partial_.find('\n'); end != std::string::npos; end = partial_.find('\n', begin)) {
      if (const auto line = parse_line(process_, partial_.substr(begin, end - begin))) pass(*line);
      begin = end + 1;
    }
    partial_.erase(0, begin);
  }

  fs::path path_;
  std::string process_, partial_;
  bus::FileDescriptor file_;
  ino_t first_inode_ = 0;  ///< 0: there was none
  std::uintmax_t first_byte_ = 0;
};

LogFollower::LogFollower(fs::path folder, Wanted wanted)
    : folder_(std::move(folder)), wanted_(std::move(wanted)), watch_(inotify_init1(IN_CLOEXEC | IN_NONBLOCK)) {
  if (!watch_.valid() ||
      inotify_add_watch(watch_.get(), folder_.c_str(), IN_MODIFY | IN_CREATE | IN_MOVED_TO | IN_MOVED_FROM) < 0) {
    throw std::runtime_error(fmt::format("cannot watch {}", folder_.string()));
  }
  for (const std::string& process : logged_processes(folder_)) {
    if (wanted_(process)) tails_[process] = std::make_unique<Tail>(current_file(folder_, process), process, true);
  }
}

LogFollower::~LogFollower() = default;

std::vector<StoredLine> LogFollower::before(const std::string& since, int tail) const {
  std::vector<StoredLine> lines;
  for (const auto& [process, end] : tails_) end->read_before(folder_, {since, tail}, lines);
  in_order(lines, tail);
  return lines;
}

void LogFollower::find_new_ones() {
  for (const std::string& process : logged_processes(folder_)) {
    if (tails_.contains(process) || !wanted_(process)) continue;
    tails_[process] = std::make_unique<Tail>(current_file(folder_, process), process, false);
  }
}

void LogFollower::run(int end_fd, const std::function<void(const StoredLine&)>& pass) {
  for (;;) {
    std::array<pollfd, 2> items{pollfd{watch_.get(), POLLIN, 0}, pollfd{end_fd, POLLIN, 0}};
    if (poll(items.data(), items.size(), -1) < 0) continue;
    std::array<char, 16384> events{};
    while (::read(watch_.get(), events.data(), events.size()) > 0) {
    }
    find_new_ones();
    for (auto& [process, tail] : tails_) tail->pass_new(pass);
    if (items[1].revents != 0) return;
  }
}

}  // namespace splatbus::cli
