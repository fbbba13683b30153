#include <cuda.h>
#include <cuda_runtime_api.h>
#include <gmock/gmock.h>

#include <cstdint>
#include <sstream>
#include <thread>

#include "bus/error.h"
#include "bus/file_descriptor.h"
#include "bus/slab_memory.h"
#include "bus_fixture.h"
#include "child_process.h"
#include "peer.h"

namespace splatbus::bus_test {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::ThrowsMessage;

bool has_device() {
  int count = 0;
  return cudaGetDeviceCount(&count) == cudaSuccess && count > 0;
}

bus::SlabDescriptor descriptor_of(std::size_t slot_bytes, Device kind = Device::Cuda) {
  return {.id = 7, .name = "maker/frames", .kind = kind, .slots = 1, .slot_bytes = slot_bytes};
}

bus::FileDescriptor duplicate(int fd) {
  return bus::FileDescriptor(::fcntl(fd, F_DUPFD_CLOEXEC, 0));
}

/// Maps the data of `data` as what `claim` says it is.
void map_as(const bus::Slab& claim, const bus::Slab& data) {
  (void)bus::map_slab_memory(claim.descriptor(), duplicate(claim.control_fd()), duplicate(data.data_fd()), false);
}

unsigned long long access_of(const bus::Slab& slab) {
  void* function = nullptr;
  cudaDriverEntryPointQueryResult result{};
  require_cuda(cudaGetDriverEntryPointByVersion("cuMemGetAccess", &function, 12000, cudaEnableDefault, &result),
               "looking up cuMemGetAccess");
  CUmemLocation location{};
  location.type = CU_MEM_LOCATION_TYPE_DEVICE;
  unsigned long long flags = 0;
  const auto address = reinterpret_cast<CUdeviceptr>(slab.slot_data(0));
  EXPECT_EQ(reinterpret_cast<decltype(&cuMemGetAccess)>(function)(&flags, &location, address), CUDA_SUCCESS);
  return flags;
}

std::vector<float> host_copy(const bus::TensorView& view) {
  std::vector<float> values(view.elements());
  if (!view.copy(values.data())) values.clear();
  return values;
}

class CudaSlabs : public BusTest {
 protected:
  void SetUp() override {
    if (!has_device()) GTEST_SKIP() << "no CUDA device";
  }

  [[nodiscard]] std::string output_path() const { return directory_.path() + "/peer"; }
  [[nodiscard]] std::vector<std::string> peer(const std::string& role) const { return {role, directory_.path()}; }
};

TEST(CudaSlabsWithoutADevice, OnlyDeviceMemoryIsRefused) {
  if (has_device()) GTEST_SKIP() << "there is a device";
  EXPECT_THAT([] { (void)bus::create_slab_memory(descriptor_of(100), true); },
              ThrowsMessage<bus::Error>(AllOf(HasSubstr("maker/frames"), HasSubstr("CUDA"))));
  EXPECT_NE(bus::create_slab_memory(descriptor_of(100, Device::Cpu), true), nullptr);
}

TEST_F(CudaSlabs, AnotherProcessReadsTheSameBytesOnTheDevice) {
  const auto context = connect("maker");
  NumberPublisher publisher(context, "viewer/probe");
  const auto slab = create_cuda_slab(*context, 3);
  (void)write_to_device(*slab, std::vector<float>(value_count, -1.0F));
  publish_number(publisher, 1, true, "", {write_to_device(*slab, make_values())});
  ChildProcess reader("test_bus_gpu", peer("--read"), output_path());
  EXPECT_EQ(reader.wait(), 0) << read_text(output_path());
}

TEST_F(CudaSlabs, OutlivesItsKilledMaker) {
  std::uint64_t id = 0;
  std::uint64_t offset = 0;
  std::uint64_t bytes = 0;
  std::uint64_t generation = 0;
  {
    ChildProcess maker("test_bus_gpu", peer("--make"), output_path());
    ASSERT_TRUE(eventually([&] { return read_text(output_path()).ends_with('\n'); }));
    ASSERT_TRUE(std::istringstream(read_text(output_path())) >> id >> offset >> bytes >> generation)
        << read_text(output_path());
    maker.send(SIGKILL);
    ASSERT_EQ(maker.wait(), -SIGKILL);
  }
  const auto slab = connect("late")->open_slab(id);
  ASSERT_NE(slab, nullptr);
  ASSERT_EQ(bytes, value_count * sizeof(float));
  const wire::Span span(id, generation, offset, bytes, wire::Storage::Slab);
  EXPECT_EQ(read_on_device(slab->data_of(span), value_count), make_values());
  std::vector<float> copied(value_count);
  EXPECT_TRUE(slab->copy(span, copied.data()));
  EXPECT_EQ(copied, make_values());
  // Its successor goes on with it.
  const auto adopted = connect("maker")->adopt_slab("maker/frames");
  ASSERT_NE(adopted, nullptr);
  EXPECT_EQ(read_on_device(adopted->slot_data(0), value_count), make_values());
  EXPECT_GT(write_to_device(*adopted, {3, 4}).span.generation(), generation);
  EXPECT_EQ(read_on_device(slab->slot_data(0), 2), (std::vector<float>{3, 4}));
}

TEST_F(CudaSlabs, BeginsZeroed) {
  const auto slab = create_cuda_slab(*connect("maker"), 1);
  EXPECT_EQ(read_on_device(slab->slot_data(0), value_count), std::vector<float>(value_count));
}

TEST_F(CudaSlabs, AnOverwrittenSlotIsReported) {
  const auto slab = create_cuda_slab(*connect("maker"), 2);
  const auto span = write_to_device(*slab, make_values()).span;
  const auto opened = connect("reader")->open_slab(slab->id());
  ASSERT_NE(opened, nullptr);
  const bus::TensorView view("values", {value_count}, bus::ElementType::F32, opened, span);
  (void)write_to_device(*slab, {1, 2});
  EXPECT_TRUE(view.still_valid());  // that was the other slot
  EXPECT_EQ(host_copy(view), make_values());
  slab->begin_write(0);
  EXPECT_FALSE(view.still_valid());
  EXPECT_THAT(host_copy(view), testing::IsEmpty());
  (void)slab->end_write(0);
  EXPECT_FALSE(view.still_valid());
}

TEST_F(CudaSlabs, HostReadersCopyAndCannotTakeADeviceAddressForTheirs) {
  const auto context = connect("maker");
  const auto slab = create_cuda_slab(*context, 1);
  const bus::TensorView view("values", {value_count}, bus::ElementType::F32, slab,
                             write_to_device(*slab, make_values()).span);
  EXPECT_EQ(view.memory(), Device::Cuda);
  EXPECT_THAT([&] { (void)view.as<float>(); },
              ThrowsMessage<bus::Error>(AllOf(HasSubstr("values"), HasSubstr("not in host memory"))));
  std::vector<float> copied;
  std::thread([&] { copied = host_copy(view); }).join();  // a thread that has met no device yet
  EXPECT_EQ(copied, make_values());
}

TEST_F(CudaSlabs, ReadersMapReadOnly) {
  const auto slab = create_cuda_slab(*connect("maker"), 1);
  const auto reader = connect("reader");
  const auto opened = reader->open_slab(slab->id());
  ASSERT_NE(opened, nullptr);
  EXPECT_NE(opened->slot_data(0), slab->slot_data(0));
  EXPECT_THROW(opened->begin_write(0), bus::Error);
  EXPECT_EQ(access_of(*slab), CU_MEM_ACCESS_FLAGS_PROT_READWRITE);
  EXPECT_EQ(access_of(*opened), CU_MEM_ACCESS_FLAGS_PROT_READ);
}

TEST_F(CudaSlabs, ASlabSmallerThanItClaimsIsRefused) {
  const auto small = bus::create_slab_memory(descriptor_of(std::size_t{2} << 20), true);
  const auto claim = bus::create_slab_memory(descriptor_of(std::size_t{6} << 20), true);
  EXPECT_THAT([&] { map_as(*claim, *small); },
              ThrowsMessage<bus::Error>(AllOf(HasSubstr("maker/frames"), HasSubstr("6291456 bytes that it claims"))));
  EXPECT_NO_THROW(map_as(*claim, *claim));
}

TEST_F(CudaSlabs, ATensorThatClaimsMoreThanItsSlabHasIsRefused) {
  const auto context = connect("maker");
  NumberPublisher publisher(context, "viewer/probe");
  const auto slab = create_cuda_slab(*context, 1);
  bus::Subscriber reader(connect("reader"), {"viewer/probe"});
  meet(publisher, reader);
  bus::OutgoingTensor lie = write_to_device(*slab, make_values());
  const wire::Span& whole = lie.span;
  lie.shape = {64 * value_count};  // far beyond what is mapped
  lie.span = wire::Span(whole.slab(), whole.generation(), 0, 64 * whole.bytes(), wire::Storage::Slab);
  publish_number(publisher, 1, false, "", {lie});
  const auto lying = reader.receive(patience);
  ASSERT_TRUE(lying.has_value());
  EXPECT_THAT([&] { (void)lying->tensor("values"); },
              ThrowsMessage<bus::Error>(AllOf(HasSubstr("values"), HasSubstr("leave their slot"))));

  publish_number(publisher, 2, false, "", {write_to_device(*slab, make_values())});
  const auto good = reader.receive(patience);
  ASSERT_TRUE(good.has_value());
  const auto view = good->tensor("values");
  ASSERT_TRUE(view.has_value());
  EXPECT_EQ(read_on_device(view->data(), view->elements()), make_values());
}

TEST_F(CudaSlabs, MemoryOfAnotherKindIsRefused) {
  const auto host = bus::create_slab_memory(descriptor_of(4096, Device::Cpu), true);
  const auto cuda = bus::create_slab_memory(descriptor_of(4096), true);
  EXPECT_THAT([&] { map_as(*cuda, *host); },
              ThrowsMessage<bus::Error>(AllOf(HasSubstr("maker/frames"), HasSubstr("not CUDA memory"))));
  EXPECT_THAT([&] { map_as(*host, *cuda); },
              ThrowsMessage<bus::Error>(AllOf(HasSubstr("maker/frames"), HasSubstr("sealed"))));
  // The descriptor says CUDA, the control block host memory.
  EXPECT_THAT(
      [&] {
        (void)bus::map_slab_memory(cuda->descriptor(), duplicate(host->control_fd()), duplicate(cuda->data_fd()),
                                   false);
      },
      ThrowsMessage<bus::Error>(HasSubstr("control block")));
}

TEST_F(CudaSlabs, TheDeviceGetsItsMemoryBack) {
  constexpr std::size_t bytes = std::size_t{1} << 30;
  const auto free_bytes = [] {
    std::size_t free = 0;
    std::size_t total = 0;
    require_cuda(cudaMemGetInfo(&free, &total), "asking for free memory");
    return free;
  };
  (void)bus::create_slab_memory(descriptor_of(4096), true);  // what the driver keeps for itself
  const std::size_t before = free_bytes();
  {
    const auto small = bus::create_slab_memory(descriptor_of(bytes), true);
    const auto claim = bus::create_slab_memory(descriptor_of(bytes + 1), true);
    EXPECT_THROW(map_as(*claim, *small), bus::Error);
    EXPECT_NO_THROW(map_as(*small, *small));
    EXPECT_LT(free_bytes() + bytes, before);
  }
  EXPECT_LT(before, free_bytes() + bytes / 4);
}

TEST_F(CudaSlabs, OnlyAFaultIsTheEndOfAProcess) {
  ChildProcess process("test_bus_gpu", peer("--fault"), output_path());
  EXPECT_EQ(process.wait(), 0) << read_text(output_path());
  EXPECT_THAT(read_text(output_path()), HasSubstr("does no more work for this process"));
}

TEST_F(CudaSlabs, ReadersOverTcpGetTheBytes) {
  const auto context = connect("maker");
  NumberPublisher publisher(context, "viewer/probe");
  const auto slab = create_cuda_slab(*context, 1);
  bus::Subscriber remote(connect_tcp("remote"), {"viewer/probe"});
  meet(publisher, remote);
  publish_number(publisher, 5, false, "", {write_to_device(*slab, make_values())});
  const auto message = remote.receive(patience);
  ASSERT_TRUE(message.has_value());
  const auto view = message->tensor("values");
  ASSERT_TRUE(view.has_value());
  EXPECT_EQ(view->memory(), Device::Cpu);
  EXPECT_EQ(host_copy(*view), make_values());
  EXPECT_EQ(broker_->statistics().inlined, 1u);
}

TEST_F(CudaSlabs, APublisherOverTcpInlinesItsOwn) {
  const auto context = connect_tcp("far");
  NumberPublisher publisher(context, "viewer/probe");
  const auto slab = create_cuda_slab(*context, 1);
  EXPECT_EQ(slab->control_fd(), -1);
  bus::Subscriber local(connect("local"), {"viewer/probe"});
  meet(publisher, local);
  publish_number(publisher, 5, false, "", {write_to_device(*slab, make_values())});
  const auto message = local.receive(patience);
  ASSERT_TRUE(message.has_value());
  const auto view = message->tensor("values");
  ASSERT_TRUE(view.has_value());
  EXPECT_EQ(host_copy(*view), make_values());
}

}  // namespace
}  // namespace splatbus::bus_test
