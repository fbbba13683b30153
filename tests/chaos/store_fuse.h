#pragma once

#include <cstdint>
#include <string>

namespace splatbus::chaos {

/// Ends this process by SIGKILL just before its `store`-th store (from 1) into memory that is shared with others, in
/// mappings whose memfd's name contains `name`, or into every so manieth of their 4 KiB; 0 counts alone. Each store
/// into them is caught by the memory's protection and done by itself, so that a death falls between any two, without a
/// word in what is tested. Linux on x86-64; a thread's stores beside another's, in the same page at the same time, may
/// go uncounted.
void arm_store_fuse(const std::string& name, std::uint64_t store, std::size_t every = 1);
/// Before the memory goes. Returns how many stores there were.
std::uint64_t disarm_store_fuse();

}  // namespace splatbus::chaos
