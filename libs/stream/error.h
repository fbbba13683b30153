#pragma once

#include <stdexcept>

namespace splatbus::stream {

/// A packet or payload that cannot be what it says; what() names the packet and the field. Whoever throws it has
/// changed nothing.
class StreamError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace splatbus::stream
