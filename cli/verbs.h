#pragma once

#include <functional>
#include <memory>
#include <string>

#include "bus/backend.h"
#include "bus/context.h"

// Declared here only: its header takes seconds to compile.
namespace CLI {
class App;
}

namespace splatbus::cli {

/// What the command line came to; returns the exit status. Errors are thrown as std::exception and reported by main.
using Action = std::function<int()>;

// Each verb adds itself to the program, and sets `action` when it is the one that was asked for.
void add_launch_verb(CLI::App& app, Action& action);
void add_operate_verbs(CLI::App& app, Action& action);
void add_param_verb(CLI::App& app, Action& action);
void add_topic_verb(CLI::App& app, Action& action);
void add_node_verb(CLI::App& app, Action& action);
void add_doctor_verb(CLI::App& app, Action& action);
void add_top_verb(CLI::App& app, Action& action);
void add_trace_verb(CLI::App& app, Action& action);
void add_keys_verb(CLI::App& app, Action& action);
void add_export_verb(CLI::App& app, Action& action);
void add_health_verb(CLI::App& app, Action& action);
/// What a launch file is exported as, to the verb export.
void add_deploy_formats(CLI::App& verb, Action& action);
void add_world_verb(CLI::App& app, Action& action);
void add_eval_verb(CLI::App& app, Action& action);
void add_demo_verb(CLI::App& app, Action& action);
void add_view_verb(CLI::App& app, Action& action);
void add_record_verb(CLI::App& app, Action& action);
void add_play_verb(CLI::App& app, Action& action);
void add_reference_verbs(CLI::App& app, Action& action);

/// Adds --bus to a verb, and --key and --server-key for one over tcp.
void add_bus_option(CLI::App& verb, std::string& address);
/// Adds --backend to a verb that launches services; empty when it is not given.
void add_backend_option(CLI::App& verb, std::string& backend);
/// What this program itself works with when services were given --backend `backend`; where that is empty, what
/// SPLATBUS_BACKEND says, else auto. Throws bus::Error.
[[nodiscard]] Device own_backend(const std::string& backend);
/// The bus that --bus names, or the default one, with its keys.
[[nodiscard]] bus::Address bus_address(const std::string& option);
/// A connection of this command, under a name of its own. Throws bus::Error at once where no bus is.
[[nodiscard]] std::shared_ptr<bus::Context> connect(const bus::Address& address);
/// The same for commands that start the bus themselves, or wait for it.
[[nodiscard]] std::shared_ptr<bus::Context> connect_later(const bus::Address& address);

}  // namespace splatbus::cli
