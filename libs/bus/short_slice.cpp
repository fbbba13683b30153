#include "bus/short_slice.h"

#include <sched.h>
#include <sys/syscall.h>
#include <unistd.h>

namespace splatbus::bus {
namespace {

/// struct sched_attr of linux/sched/types.h, version 0: glibc before 2.41 has neither it nor the calls.
struct Scheduling {
  std::uint32_t size = sizeof(Scheduling);
  std::uint32_t policy = 0;
  std::uint64_t flags = 0;
  std::int32_t nice = 0;
  std::uint32_t priority = 0;
  std::uint64_t runtime_ns = 0;  ///< of the default policy: the slice
  std::uint64_t deadline_ns = 0, period_ns = 0;
};
static_assert(sizeof(Scheduling) == 48);

std::optional<Scheduling> scheduling(int thread) {
  Scheduling read;
  if (::syscall(SYS_sched_getattr, thread, &read, sizeof(read), 0) != 0 || read.policy != SCHED_OTHER) return {};
  return read;
}

void set_slice(std::uint64_t slice_ns) {
  auto changed = scheduling(0);
  if (!changed) return;
  changed->runtime_ns = slice_ns;
  // That is all that is asked for: whoever forbids it loses speed.
  static_cast<void>(::syscall(SYS_sched_setattr, 0, &*changed, 0));
}

}  // namespace

std::optional<std::uint64_t> slice_ns(int thread) {
  const auto read = scheduling(thread);
  if (!read) return {};
  return read->runtime_ns;
}

ShortSlice::ShortSlice() : before_ns_(slice_ns(0)) {
  if (before_ns_) set_slice(kSlice_ns);
}

ShortSlice::~ShortSlice() {
  if (before_ns_) set_slice(*before_ns_);
}

}  // namespace splatbus::bus
