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

/// A launch file or an override that cannot be used. what() begins with the place: "demo.yaml:12:5: unknown key
/// 'parametres' ...".
class LaunchError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
  LaunchError(const SourceMark& mark, const std::string& text) : std::runtime_error(mark.text() + ": " + text) {}
};

template <class T>
struct Marked {
  T value{};
  SourceMark mark;
};

enum class RestartPolicy { Always, OnFailure, Never };

/// One entry of `services:`.
struct LaunchService {
  SourceMark mark;
  std::string name;                                       ///< source on the bus, unique
  Marked<std::string> program;                            ///< a path, or a name looked up beside the splatbus program
  std::map<std::string, Marked<std::string>> parameters;  ///< become --set name=value
  std::vector<std::string> args;
  std::map<std::string, std::string> environment;  ///< added to ours
  std::optional<Marked<std::string>> bus;          ///< a bus of its own, e.g. tcp://host:port
  std::optional<Marked<std::string>> backend;      ///< cpu, cuda or auto, before the file's
  int replicas = 1;                                ///< more than 1: name-1, name-2, ...
  RestartPolicy restart = RestartPolicy::OnFailure;
  std::vector<Marked<std::string>> after;  ///< names of services that have to be ready first
  double heartbeat_timeout_s = 5;          ///< 0: sends none, and is ready as soon as it runs
  double start_timeout_s = 30;             ///< until the first heartbeat
};

struct LaunchFile {
  std::string path;
  std::optional<Marked<std::string>> bus;
  std::optional<Marked<std::string>> backend;  ///< of every service that names none
  std::optional<Marked<std::string>> world;    ///< folder that its trainers keep their model in
  std::vector<LaunchService> services;

  [[nodiscard]] LaunchService* find(const std::string& name);
};

/// Strict: unknown keys, wrong types, duplicate names, dependencies on nobody and cycles are refused. Throws
/// LaunchError.
[[nodiscard]] LaunchFile read_launch_file(const std::string& path);
[[nodiscard]] LaunchFile parse_launch_file(const std::string& yaml, const std::string& path);

/// The backend of every service that names none, instead of the file's; empty changes nothing.
void set_backend(LaunchFile& file, const std::string& backend);

/// The folder that the trainers keep their model in, instead of the file's; empty changes nothing. Throws LaunchError
/// when the file has no trainer.
void set_world(LaunchFile& file, const std::string& folder);

/// Applies "service.key=value", value of a parameter. Throws LaunchError that names the known services.
void apply_override(LaunchFile& file, const std::string& assignment);

}  // namespace splatbus::cli
