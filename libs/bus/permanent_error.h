#pragma once

#include "bus/error.h"

namespace splatbus::bus {

/// What would only happen again if the program were started again: a key file that is not there, a port in use.
class PermanentError : public Error {
 public:
  using Error::Error;
};

/// Exit status of a program that ended for a PermanentError (EX_CONFIG of sysexits.h; docs/operate.md): a supervisor
/// reports it and does not start it again.
inline constexpr int kExitPermanent = 78;

}  // namespace splatbus::bus
