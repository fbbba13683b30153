#pragma once

#include <stdexcept>

namespace splatbus::bus {

/// What a peer, a file or the system did wrong; what() names the thing and the place. Thrown by libs/bus only where a
/// header says so.
class Error : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace splatbus::bus
