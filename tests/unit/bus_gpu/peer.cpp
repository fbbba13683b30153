#include "peer.h"

#include <cuda_runtime_api.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cstdio>
#include <stdexcept>
#include <string>

#include "bus/error.h"
#include "bus/memory.h"
#include "bus/subscriber.h"
#include "bus_fixture.h"
#include "fault.h"

namespace splatbus::bus_test {
namespace {

constexpr std::size_t value_bytes = value_count * sizeof(float);

int make(const bus::Address& address) {
  const auto context = bus::Context::create(address, "maker");
  const auto slab = create_cuda_slab(*context, 1);
  const auto span = write_to_device(*slab, make_values()).span;
  fmt::print("{} {} {} {}\n", span.slab(), span.offset(), span.bytes(), span.generation());
  std::fflush(stdout);
  for (;;) ::pause();
}

int read(const bus::Address& address) {
  bus::Subscriber subscriber(bus::Context::create(address, "reader"), {"viewer/probe"});
  const auto message = subscriber.receive(patience);
  const auto view = message ? message->tensor("values", bus::ElementType::F32, {0}) : std::nullopt;
  if (!view) throw bus::Error("no tensor came");
  if (view->memory() != Device::Cuda) throw bus::Error("the tensor is not in device memory");
  if (read_on_device(view->data(), view->elements()) != make_values()) throw bus::Error("other values came");
  if (!view->still_valid()) throw bus::Error("the slot was overwritten");
  return 0;
}

/// Memory that there is too little of is another matter than a device that has failed for good.
int fault() {
  constexpr std::size_t far_too_much = std::size_t{1} << 50;
  try {
    (void)bus::allocate_memory(Device::Cuda, far_too_much);
    throw std::logic_error("memory that does not exist was given");
  } catch (const bus::Error& error) {
    if (std::string(error.what()).find(std::to_string(far_too_much)) == std::string::npos) {
      throw std::logic_error(fmt::format("it is not said how much was asked for: {}", error.what()));
    }
    bus::require_usable(Device::Cuda);
  }
  (void)bus::allocate_memory(Device::Cuda, 4096);
  launch_fault();
  try {
    bus::require_usable(Device::Cuda);
  } catch (const bus::Error& error) {
    fmt::print("{}\n", error.what());
    return 0;
  }
  throw std::logic_error("the fault was not noticed");
}

}  // namespace

std::vector<float> make_values() {
  std::vector<float> values(value_count);
  for (std::size_t i = 0; i < value_count; ++i) values[i] = 1.0F + 0.5F * static_cast<float>(i);
  return values;
}

void require_cuda(int status, const char* what) {
  const auto error = static_cast<cudaError_t>(status);
  if (error != cudaSuccess) throw bus::Error(fmt::format("{}: {}", what, cudaGetErrorString(error)));
}

std::shared_ptr<bus::Slab> create_cuda_slab(bus::Context& context, std::size_t slots) {
  return context.create_slab("frames", slots, value_bytes, 10000, Device::Cuda);
}

bus::OutgoingTensor write_to_device(bus::Slab& slab, const std::vector<float>& values) {
  const std::size_t slot = slab.next_slot();
  const std::size_t bytes = values.size() * sizeof(float);
  require_cuda(cudaMemcpy(slab.slot_data(slot), values.data(), bytes, cudaMemcpyHostToDevice), "writing a slab");
  require_cuda(cudaDeviceSynchronize(), "waiting for the write");
  const auto generation = slab.end_write(slot);
  bus::OutgoingTensor tensor;
  tensor.name = "values";
  tensor.shape = {static_cast<std::uint32_t>(values.size())};
  tensor.span = slab.span(slot, 0, bytes, generation);
  return tensor;
}

std::vector<float> read_on_device(const std::byte* device_address, std::size_t count) {
  void* own = nullptr;
  std::vector<float> values(count);
  const std::size_t bytes = count * sizeof(float);
  require_cuda(cudaMalloc(&own, bytes), "allocating");
  const auto copied = cudaMemcpy(own, device_address, bytes, cudaMemcpyDeviceToDevice);
  const auto fetched = cudaMemcpy(values.data(), own, bytes, cudaMemcpyDeviceToHost);
  cudaFree(own);
  require_cuda(copied, "reading a slab on the device");
  require_cuda(fetched, "fetching");
  return values;
}

int run_peer(const std::string& role, const std::string& folder) {
  const auto address = bus::Address::parse("ipc://" + folder);
  if (role == "--make") return make(address);
  if (role == "--read") return read(address);
  if (role == "--fault") return fault();
  throw bus::Error(fmt::format("'{}' is no role", role));
}

}  // namespace splatbus::bus_test
