#pragma once

namespace splatbus::viewer {

/// The viewer without a bus, beside a streamer on another machine: --connect ENDPOINT, --name, --backend, --set,
/// --log-level. Returns the exit status.
int standalone_main(int argc, char** argv);

}  // namespace splatbus::viewer
