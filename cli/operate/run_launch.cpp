#include "run_launch.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <cstring>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <thread>

#include "bus/file_descriptor.h"
#include "control_request.h"
#include "control_server.h"
#include "log_store.h"
#include "operator_verbs.h"
#include "supervised_run.h"
#include "supervisor.h"
#include "swap_verb.h"
#include "terminal.h"

namespace splatbus::cli {

namespace {

/// In this process. `listening` is called once the operator's verbs are answered.
int supervise(const RunLaunch& launch, const std::function<void()>& listening) {
  ControlServer control(launch.plan.bus);
  const StopSignals signals;
  const std::filesystem::path folder = log_folder(launch.plan.bus);
  std::optional<LogStore> logs;
  try {
    if (!folder.empty()) logs.emplace(folder);
  } catch (const std::runtime_error& error) {
    fmt::print(stderr, "splatbus: {}\n", error.what());
  }
  std::vector<std::string> names;
  for (const ProcessPlan& process : launch.plan.processes) names.push_back(process.name);
  const PrefixedOutput output(names, !launch.json && wants_color(STDOUT_FILENO));
  Supervisor supervisor(launch.plan, [&](const OutputLine& line) {
    const std::string json = event_json(line);
    if (logs) logs->write(line);
    control.publish_line(json);
    if (launch.json) {
      fmt::print("{}\n", json);
      std::fflush(stdout);
    } else {
      output.print(line.process, line.text, !line.event.empty());
    }
  });

  std::stop_source stop;
  const std::stop_callback on_signal(signals.stop(), [&] { stop.request_stop(); });
  const auto operated = std::make_shared<Operated>(Operated{.supervisor = supervisor,
                                                            .file = launch.file,
                                                            .bus = launch.plan.bus,
                                                            .log_folder = logs ? folder.string() : std::string(),
                                                            .stop = [&stop] { stop.request_stop(); }});
  add_operator_verbs(control, operated);
  add_swap_handler(control, operated);
  // Handlers refer to what is above, which goes before the server does.
  const std::unique_ptr<ControlServer, void (*)(ControlServer*)> answering(&control,
                                                                           [](ControlServer* c) { c->stop(); });
  control.start();
  listening();
  std::jthread timer;
  if (launch.seconds > 0) {
    timer = std::jthread([&](const std::stop_token& end) {
      std::mutex mutex;
      std::unique_lock lock(mutex);
      std::condition_variable_any().wait_for(lock, end, std::chrono::duration<double>(launch.seconds),
                                             [] { return false; });
      stop.request_stop();
    });
  }
  if (supervisor.run(stop.get_token(), signals.kill())) return 0;
  for (const std::string& what : supervisor.not_running()) fmt::print(stderr, "splatbus launch: {}\n", what);
  return 1;
}

void write_all(int fd, const std::string& text) {
  [[maybe_unused]] const auto written = write(fd, text.data(), text.size());
}

/// What a daemon is: no terminal, no session of ours, its own group; the working folder stays, for relative paths in
/// launch files. Tells through `report` that it listens, or why it does not.
[[noreturn]] void become_daemon(const RunLaunch& launch, int report) {
  setsid();
  const pid_t daemon = fork();
  if (daemon != 0) _exit(daemon < 0 ? 1 : 0);
  const bus::FileDescriptor null(open("/dev/null", O_RDWR | O_CLOEXEC));
  for (const int fd : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) dup2(null.get(), fd);
  int status = 1;
  bool told = false;
  try {
    status = supervise(launch, [&] {
      told = true;
      write_all(report, "listening");
      close(report);
    });
  } catch (const std::exception& error) {
    if (!told) write_all(report, error.what());
  }
  _exit(status);
}

int detach(const RunLaunch& launch) {
  std::array<int, 2> fds{};
  if (pipe2(fds.data(), O_CLOEXEC) != 0) throw std::runtime_error("cannot make a pipe");
  bus::FileDescriptor read_end(fds[0]), write_end(fds[1]);
  std::fflush(nullptr);
  const pid_t child = fork();
  if (child < 0) throw std::runtime_error(fmt::format("cannot fork: {}", std::strerror(errno)));
  if (child == 0) {
    read_end.reset();
    become_daemon(launch, write_end.get());
  }
  write_end.reset();
  waitpid(child, nullptr, 0);
  std::string report;
  std::array<char, 1024> chunk{};
  for (ssize_t got = 0; (got = read(read_end.get(), chunk.data(), chunk.size())) > 0;) {
    report.append(chunk.data(), static_cast<std::size_t>(got));
  }
  if (report != "listening") throw std::runtime_error(report.empty() ? "the supervisor ended at once" : report);
  try {
    static_cast<void>(ask_supervisor(launch.plan.bus, {{"verb", "wait"}, {"wait_s", launch.ready_within_s}}));
  } catch (const std::runtime_error& error) {
    throw std::runtime_error(
        fmt::format("not everything is ready: {} (see 'splatbus logs'; 'splatbus down' stops the rest)", error.what()));
  }
  fmt::print("{} processes run on {}\n", launch.plan.processes.size(), launch.plan.bus.text());
  return 0;
}

}  // namespace

int run_launch(const RunLaunch& launch) {
  if (!launch.invitation.empty()) {
    fmt::print("{}\n", launch.invitation);
    std::fflush(stdout);
  }
  return launch.detach ? detach(launch) : supervise(launch, [] {});
}

}  // namespace splatbus::cli
