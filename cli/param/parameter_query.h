#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "bus/context.h"
#include "bus/parameter_json.h"
#include "bus/publisher.h"

namespace splatbus::cli {

/// A process on the bus that has parameters, as its last heartbeat tells.
struct ParameterOwner {
  std::string source, kind;
  std::uint32_t pid = 0;
  std::vector<std::pair<std::string, std::string>> values;  ///< in the order of the program
  std::map<std::string, wire::ValueType> types;             ///< as declared; Unsaid where the process does not say

  [[nodiscard]] const std::string* find(const std::string& key) const;
  [[nodiscard]] std::vector<std::string> names() const;
};

/// The processes that a name means: the one of that source, or all of that kind; all there are when it is empty. Throws
/// std::runtime_error that names the nearest when there is none alive, and when the bus tells nothing within seconds.
[[nodiscard]] std::vector<ParameterOwner> find_owners(const std::shared_ptr<bus::Context>& context,
                                                      const std::string& name);

/// What the program of a kind says of its parameters, with `changes` made; nullopt when this installation has no such
/// program. Nothing is started by it.
[[nodiscard]] std::optional<bus::ParameterReport> ask_program(const std::string& kind,
                                                              const std::map<std::string, std::string>& changes,
                                                              const std::filesystem::path& programs);

/// Sends control/<receiver>.
void send_control(bus::Publisher& publisher, const std::string& receiver,
                  const std::vector<std::pair<std::string, std::string>>& changes);

/// Sends the change and waits for the answer: the heartbeat that has the value, or the log line that refuses it.
/// Returns the value as the service has it now. Throws std::runtime_error with the refusal, or when no answer comes.
[[nodiscard]] std::string set_parameter(const std::shared_ptr<bus::Context>& context, const ParameterOwner& owner,
                                        const std::string& key, const std::string& value);

}  // namespace splatbus::cli
