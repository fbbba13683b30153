#pragma once

#include <memory>
#include <string>
#include <vector>

#include "bus/context.h"
#include "bus/slab.h"
#include "bus/tensor.h"

namespace splatbus::bus_test {

/// More than one block of the driver's 2 MiB, and no multiple of one.
constexpr std::size_t value_count = 700'001;

/// What the tests' slabs hold.
std::vector<float> make_values();

/// Throws bus::Error naming `what` unless CUDA succeeded.
void require_cuda(int status, const char* what);

std::shared_ptr<bus::Slab> create_cuda_slab(bus::Context& context, std::size_t slots);

/// Copies the values to the next slot, on the device when this returns, and makes them the tensor "values".
bus::OutgoingTensor write_to_device(bus::Slab& slab, const std::vector<float>& values);

/// Copies device memory to other device memory, and that to the host: what a kernel would read.
std::vector<float> read_on_device(const std::byte* device_address, std::size_t count);

/// The other process, by its first argument; its exit status. "--make FOLDER": makes a slab as "maker", writes it,
/// prints "ID OFFSET BYTES GENERATION" and waits to be killed. "--read FOLDER": reads the tensor of the latched message
/// on "viewer/probe" on the device. "--fault FOLDER": runs out of memory, then lets a kernel fail, and prints what
/// require_usable() says to that.
int run_peer(const std::string& role, const std::string& folder);

}  // namespace splatbus::bus_test
