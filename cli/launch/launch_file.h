#pragma once

#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace splatbus::cli {

/// Where a setting was written: a place in a launch file, or an option of the command line (line 0).
struct SourceMark {
  std::string file;
  int line = 0;
  int column = 0;

  [[nodiscard]] std::string text() const;  ///< "launch/demo.yaml:12:5", or "--set"
};

/// One thing that is wrong with a launch file.
struct LaunchProblem {
  SourceMark mark;
  std::string text;
};

/// A launch file or an override that cannot be used. what() has a line for each problem that begins with its place:
/// "demo.yaml:12:5: unknown key 'parametres' ...".
class LaunchError : public std::runtime_error {
 public:
  explicit LaunchError(std::vector<LaunchProblem> problems);
  LaunchError(const SourceMark& mark, const std::string& text) : LaunchError({{mark, text}}) {}
  [[nodiscard]] const std::vector<LaunchProblem>& problems() const { return problems_; }

 private:
  std::vector<LaunchProblem> problems_;
};

template <class T>
struct Marked {
  T value{};
  SourceMark mark;
};

enum class RestartPolicy { Always, OnFailure, Never };

/// When a process that has ended is started again.
struct RestartRules {
  RestartPolicy policy = RestartPolicy::OnFailure;
  int max_attempts = 8;  ///< ends in a row; 0: no limit
  double window_s = 10;  ///< a process that was ready for that long begins to count anew
  double first_delay_s = 0.1;
  double max_delay_s = 8;  ///< the delay doubles with every attempt up to this
};

/// How the supervisor asks a process that sends no heartbeat, or besides its heartbeat, how it is.
struct Probe {
  enum class Kind { Tcp, Http, Command };
  Kind kind = Kind::Tcp;
  SourceMark mark;
  std::string target;                ///< "host:port", or an http:// URL: good with a status of 200 to 399
  std::vector<std::string> command;  ///< good with exit status 0
  double period_s = 1;
  double timeout_s = 1;  ///< an answer that takes longer is a failure
  int failures = 3;      ///< in a row that count
};

/// One entry of `services:`.
struct LaunchService {
  SourceMark mark;
  std::string name;                                       ///< source on the bus, unique
  Marked<std::string> program;                            ///< a path, or a name looked up beside the splatbus program
  std::map<std::string, Marked<std::string>> parameters;  ///< become --set name=value
  std::vector<std::string> args;
  std::vector<SourceMark> arg_marks;               ///< of the first of args; others have none
  std::map<std::string, std::string> environment;  ///< added to ours
  std::optional<Marked<std::string>> backend;      ///< cpu, cuda or auto, before the file's
  int replicas = 1;                                ///< more than 1: name-1, name-2, ...
  int nice = 0;                                    ///< 0 to 19, as of nice(1)
  RestartRules restart;
  std::vector<Marked<std::string>> after;  ///< names of services that have to be ready first
  double heartbeat_timeout_s = 5;          ///< 0: sends none, and is ready as soon as it runs, or `readiness` says so
  double start_timeout_s = 30;             ///< until it is ready
  double stop_timeout_s = 3;               ///< from SIGTERM to SIGKILL
  std::optional<Probe> readiness;          ///< has to be good once before the process counts as ready
  std::optional<Probe> liveness;           ///< once it is not, the process is killed and started again
};

struct LaunchFile {
  std::string path;
  std::optional<Marked<std::string>> bus;
  std::optional<Marked<std::string>> backend;  ///< of every service that names none
  std::optional<Marked<std::string>> world;    ///< folder that its trainers keep their model in
  std::vector<LaunchService> services;         ///< of included files first
  std::vector<std::string> files;              ///< this one and all that it includes

  [[nodiscard]] LaunchService* find(const std::string& name);
  [[nodiscard]] std::vector<std::string> service_names() const;
};

/// Values of a launch file's arguments, as `launch FILE name=value` gives them.
using LaunchArguments = std::map<std::string, std::string>;

/// Parses "name=value". Throws LaunchError.
[[nodiscard]] LaunchArguments parse_arguments(const std::vector<std::string>& assignments);

/// Strict: unknown keys, names and arguments, wrong types, duplicate names, dependencies on nobody and cycles, of
/// services and of files, are refused, all of them at once. Files are read where they are included. Throws LaunchError.
[[nodiscard]] LaunchFile read_launch_file(const std::string& path, const LaunchArguments& arguments = {});
[[nodiscard]] LaunchFile parse_launch_file(const std::string& yaml, const std::string& path,
                                           const LaunchArguments& arguments = {});

/// The backend of every service that names none, instead of the file's; empty changes nothing.
void set_backend(LaunchFile& file, const std::string& backend);

/// The folder that the trainers keep their model in, instead of the file's; empty changes nothing. Throws LaunchError
/// when the file has no trainer.
void set_world(LaunchFile& file, const std::string& folder);

/// Applies "service.key=value", value of a parameter. Throws LaunchError that names the nearest service.
void apply_override(LaunchFile& file, const std::string& assignment);

/// What a launch file comes to: a JSON schema (draft 7) for editors, made from the keys that are read.
[[nodiscard]] std::string launch_schema();

}  // namespace splatbus::cli
