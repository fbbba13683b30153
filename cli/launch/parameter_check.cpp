#include "parameter_check.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <poll.h>

#include <algorithm>
#include <chrono>
#include <optional>
#include <span>

#include "bus/clock.h"
#include "bus/error.h"
#include "child_process.h"

namespace splatbus::cli {

namespace {

constexpr std::chrono::seconds kPatience(30), kForeignPatience(5);
constexpr std::size_t kMostBytes = std::size_t{4} << 20;  // of a report
constexpr std::size_t kMostProblems = 100, kMostText = 1000;

struct Question {
  const LaunchService* service;
  ChildProcess child;
  bool ours;
};

/// Output and exit status of a program that is expected to end by itself.
struct Answer {
  ExitStatus status;
  std::string output;
};

/// Nullopt when it takes until then, or says more than any report has.
std::optional<Answer> wait_for(ChildProcess& child, std::int64_t until_ns) {
  std::string output;
  const auto read = [&](bool rest) {
    for (const std::string& line : child.read_lines(rest)) output += line + "\n";
  };
  // Read while it runs: a report is larger than a pipe.
  while (output.size() <= kMostBytes) {
    const std::int64_t left_ms = (until_ns - bus::now_ns()) / 1'000'000;
    pollfd events[] = {{.fd = child.exit_fd(), .events = POLLIN, .revents = 0},
                       {.fd = child.output_fd(), .events = POLLIN, .revents = 0}};
    poll(events, child.output_fd() >= 0 ? 2 : 1, static_cast<int>(std::clamp<std::int64_t>(left_ms, 0, 100)));
    const auto status = child.poll_exit();
    read(status.has_value());
    if (status) return Answer{*status, output.substr(0, output.find_last_not_of('\n') + 1)};
    if (left_ms <= 0) break;
  }
  return {};
}

/// What a program printed, fit for a terminal.
std::string tame(std::string text) {
  if (text.size() > kMostText) text = text.substr(0, kMostText) + "...";
  std::ranges::replace_if(
      text, [](char c) { return (static_cast<unsigned char>(c) < 0x20 && c != '\n' && c != '\t') || c == 0x7f; }, '?');
  return text;
}

std::int64_t from_now(std::chrono::nanoseconds time) {
  return bus::now_ns() + time.count();
}

/// Where the setting stands that the text is about.
SourceMark place_of(const LaunchService& service, const std::string& text) {
  for (std::size_t i = 0; i < std::min(service.args.size(), service.arg_marks.size()); ++i) {
    const std::string& arg = service.args[i];
    const std::string name = arg.substr(0, arg.find('='));
    if (!name.empty() && text.find(name) != std::string::npos) return service.arg_marks[i];
  }
  for (const auto& [key, setting] : service.parameters) {
    if (text.find("'" + key + "'") != std::string::npos) return setting.mark;
  }
  return service.mark;
}

void add_problems(const LaunchService& service, const Answer& answer, std::vector<LaunchProblem>& problems) {
  try {
    const auto report = bus::parse_parameter_report(answer.output);
    const std::size_t taken = std::min(report.problems.size(), kMostProblems);
    for (const auto& problem : std::span(report.problems).first(taken)) {
      const auto setting = service.parameters.find(problem.parameter);
      const SourceMark mark =
          setting != service.parameters.end() ? setting->second.mark : place_of(service, problem.text);
      problems.push_back({mark, fmt::format("service '{}': {}", service.name, tame(problem.text))});
    }
  } catch (const bus::Error&) {
    // What the program says of its arguments is one line, with a word on its help.
    const std::string text = tame(answer.output.substr(0, answer.output.find("\nRun with --help")));
    problems.push_back(
        {place_of(service, text), fmt::format("service '{}' refuses its arguments: {}", service.name, text)});
  }
}

}  // namespace

std::optional<bus::ParameterReport> ask_parameters(const std::filesystem::path& program,
                                                   std::vector<std::string> arguments,
                                                   const std::map<std::string, std::string>& environment) {
  arguments.insert(arguments.end(), {"--parameters", "--json"});
  ChildProcess child(program, arguments, environment);
  const auto answer = wait_for(child, from_now(kPatience));
  if (!answer) return {};
  try {
    return bus::parse_parameter_report(answer->output);
  } catch (const bus::Error&) {
    return {};
  }
}

void check_parameters(const LaunchFile& file, const LaunchPlan& plan) {
  std::vector<LaunchProblem> problems;
  std::vector<Question> questions;
  for (const LaunchService& service : file.services) {
    const auto process = std::find_if(plan.processes.begin(), plan.processes.end(),
                                      [&](const ProcessPlan& p) { return p.service == service.name; });
    if (process == plan.processes.end()) continue;
    const bool ours = process->program.filename().string().starts_with("splatbus-") && service.heartbeat_timeout_s > 0;
    if (!ours && service.parameters.empty()) continue;
    std::vector<std::string> arguments = process->arguments;
    arguments.insert(arguments.end(), {"--parameters", "--json"});
    try {
      questions.push_back({&service, ChildProcess(process->program, arguments, process->environment), ours});
    } catch (const std::runtime_error& error) {
      problems.push_back({service.program.mark, error.what()});
    }
  }
  const std::int64_t until_ns = from_now(kPatience), foreign_until_ns = from_now(kForeignPatience);
  for (Question& question : questions) {
    const auto answer = wait_for(question.child, question.ours ? until_ns : foreign_until_ns);
    if (answer && !answer->status.success()) add_problems(*question.service, *answer, problems);
    // One of others need not know the question, and is killed over it.
    if (!answer && question.ours) {
      problems.push_back(
          {question.service->program.mark,
           fmt::format("service '{}': its program does not answer to --parameters", question.service->name)});
    }
  }
  if (!problems.empty()) throw LaunchError(std::move(problems));
}

}  // namespace splatbus::cli
