#include "bus/slab_registry.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <future>

#include "bus/error.h"
#include "bus/file_descriptor.h"
#include "bus/slab_client.h"
#include "bus/slab_memory.h"
#include "bus/slab_protocol.h"
#include "bus_fixture.h"
#include "log_capture.h"

namespace splatbus::bus_test {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

sockaddr_un socket_address(const std::string& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::strncpy(address.sun_path, path.c_str(), sizeof(address.sun_path) - 1);
  return address;
}

bus::FileDescriptor connect_to(const std::string& path) {
  bus::FileDescriptor socket(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0));
  const auto address = socket_address(path);
  EXPECT_EQ(::connect(socket.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
  const timeval timeout{10, 0};
  ::setsockopt(socket.get(), SOL_SOCKET, SO_RCVTIMEO, &timeout, sizeof(timeout));
  return socket;
}

bus::SlabDescriptor descriptor_of(std::uint64_t id, const std::string& name, std::size_t slot_bytes) {
  bus::SlabDescriptor result;
  result.id = id;
  result.name = name;
  result.slots = 1;
  result.slot_bytes = slot_bytes;
  return result;
}

/// Speaks the registry's protocol by hand, with claims of its own.
class SlabRegistry : public BusTest {
 protected:
  SlabRegistry() : socket_(connect_to(directory_.address().slab_socket())) {}

  bus::SlabPacket ask(bus::SlabOperation operation, const bus::SlabDescriptor& descriptor, int control, int data) {
    bus::SlabPacket request;
    request.operation = operation;
    request.descriptor = descriptor;
    bus::send_slab_packet(socket_.get(), request, control, data);
    auto answer = bus::receive_slab_packet(socket_.get());
    if (!answer) throw bus::Error("the registry closed the connection");
    return std::move(*answer);
  }

  void expect_refused(const bus::SlabDescriptor& descriptor, int control, int data, const std::string& why) {
    const auto answer = ask(bus::SlabOperation::Register, descriptor, control, data);
    EXPECT_EQ(answer.status, bus::SlabStatus::Refused);
    EXPECT_THAT(answer.text, testing::AllOf(HasSubstr(why), HasSubstr(descriptor.name)));
    EXPECT_EQ(broker_->statistics().slabs, 0u);
  }

  bus::FileDescriptor socket_;
};

TEST_F(SlabRegistry, ASlabSmallerThanItClaimsIsRefused) {
  const auto slab = bus::create_slab_memory(descriptor_of(7, "maker/small", 4096), true);
  // The data is 4096 bytes, the claim 8192; the control block agrees with the claim.
  const auto claim = bus::create_slab_memory(descriptor_of(7, "maker/small", 8192), true);
  expect_refused(claim->descriptor(), claim->control_fd(), slab->data_fd(), "4096 bytes, less than the 8192");
  // The control block is smaller than the slots need.
  auto many_slots = claim->descriptor();
  many_slots.slots = 60000;
  expect_refused(many_slots, claim->control_fd(), claim->data_fd(), "control block");
  // And one that disagrees with the registration.
  expect_refused(claim->descriptor(), slab->control_fd(), claim->data_fd(), "control block says");
}

TEST_F(SlabRegistry, MemoryThatItsMakerCouldShrinkIsRefused) {
  const auto slab = bus::create_slab_memory(descriptor_of(7, "maker/soft", 4096), true);
  const bus::FileDescriptor soft(::memfd_create("soft", MFD_CLOEXEC | MFD_ALLOW_SEALING));
  ASSERT_EQ(::ftruncate(soft.get(), 4096), 0);
  expect_refused(slab->descriptor(), slab->control_fd(), soft.get(), "sealed");
  const bus::FileDescriptor null(::open("/dev/null", O_RDWR | O_CLOEXEC));
  expect_refused(slab->descriptor(), slab->control_fd(), null.get(), "sealed");
  expect_refused(slab->descriptor(), null.get(), slab->data_fd(), "sealed");
}

TEST_F(SlabRegistry, RegistrationsWithoutSenseAreRefused) {
  const auto slab = bus::create_slab_memory(descriptor_of(7, "maker/good", 4096), true);
  expect_refused(slab->descriptor(), -1, -1, "without");
  auto other_kind = slab->descriptor();
  other_kind.kind = static_cast<Device>(9);
  expect_refused(other_kind, slab->control_fd(), slab->data_fd(), "kind 9");
  auto nothing = slab->descriptor();
  nothing.slots = 0;
  expect_refused(nothing, slab->control_fd(), slab->data_fd(), "0 slots");
  // The same connection serves a good one.
  EXPECT_EQ(ask(bus::SlabOperation::Register, slab->descriptor(), slab->control_fd(), slab->data_fd()).status,
            bus::SlabStatus::Ok);
  EXPECT_EQ(broker_->statistics().slabs, 1u);
  // Nobody else takes its id.
  auto thief = slab->descriptor();
  thief.name = "thief/good";
  EXPECT_EQ(ask(bus::SlabOperation::Register, thief, slab->control_fd(), slab->data_fd()).status,
            bus::SlabStatus::Refused);
}

TEST_F(SlabRegistry, GarbageEndsThatConnectionOnly) {
  const auto other = connect_to(directory_.address().slab_socket());
  ASSERT_GT(::send(other.get(), "garbage", 7, 0), 0);
  char byte = 0;
  EXPECT_EQ(::recv(other.get(), &byte, 1, 0), 0);
  EXPECT_EQ(ask(bus::SlabOperation::OpenByName, descriptor_of(0, "maker/none", 1), -1, -1).status,
            bus::SlabStatus::NotFound);
  EXPECT_THROW(ask(static_cast<bus::SlabOperation>(77), descriptor_of(1, "a", 1), -1, -1), bus::Error);
}

TEST_F(SlabRegistry, WhoLeavesUnderManyNamesIsTalkedOfOnceASecond) {
  const std::string path = directory_.path() + "/other-slabs";
  const LogCapture log;
  {
    const bus_service::SlabRegistry registry(path, 0ms);
    socket_ = connect_to(path);
    for (std::uint64_t i = 1; i <= 60; ++i) {
      const auto of_one = bus::create_slab_memory(descriptor_of(i, "maker-" + std::to_string(i) + "/ring", 4096), true);
      EXPECT_EQ(ask(bus::SlabOperation::Register, of_one->descriptor(), of_one->control_fd(), of_one->data_fd()).status,
                bus::SlabStatus::Ok);
    }
    EXPECT_EQ(registry.size(), 60U);
    socket_.reset();
    const bus::FileDescriptor next = connect_to(path);  // its turn ends the others' leases
    EXPECT_TRUE(eventually([&] { return registry.size() == 0; }));
  }
  EXPECT_GT(log.lines(), 0);
  EXPECT_LT(log.lines(), 50);
}

TEST_F(SlabRegistry, OneProcessHasAFewNamesOnly) {
  for (int i = 0; i < 200; ++i) {
    const auto answer =
        ask(bus::SlabOperation::OpenByName, descriptor_of(0, "maker-" + std::to_string(i) + "/none", 1), -1, -1);
    EXPECT_EQ(answer.status, i < 64 ? bus::SlabStatus::NotFound : bus::SlabStatus::Refused) << i;
  }
  EXPECT_EQ(ask(bus::SlabOperation::OpenByName, descriptor_of(0, "maker-5/none", 1), -1, -1).status,
            bus::SlabStatus::NotFound)
      << "a name that it has";
}

/// A registry that hands out less than it says, to see what the client makes of it.
TEST(SlabClient, ASlabSmallerThanItClaimsIsAClearError) {
  const TemporaryDirectory directory;
  const bus::FileDescriptor listener(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0));
  const auto address = socket_address(directory.address().slab_socket());
  ASSERT_EQ(::bind(listener.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
  ASSERT_EQ(::listen(listener.get(), 1), 0);
  const auto small = bus::create_slab_memory(descriptor_of(7, "maker/small", 4096), true);
  const auto claim = bus::create_slab_memory(descriptor_of(7, "maker/small", 1 << 20), true);
  auto server = std::async(std::launch::async, [&] {
    const bus::FileDescriptor client(::accept(listener.get(), nullptr, nullptr));
    const auto request = bus::receive_slab_packet(client.get());
    bus::SlabPacket answer;
    answer.descriptor = claim->descriptor();
    bus::send_slab_packet(client.get(), answer, claim->control_fd(), small->data_fd());
    return request.has_value();
  });
  const auto context = bus::Context::create(directory.address(), "reader");
  std::string problem;
  ASSERT_TRUE(eventually([&] {
    try {
      (void)context->open_slab(7);
    } catch (const bus::Error& error) {
      problem = error.what();
    }
    return !problem.empty();
  }));
  EXPECT_THAT(problem, testing::AllOf(HasSubstr("maker/small"), HasSubstr("4096 bytes, less than the 1048576")));
  EXPECT_TRUE(server.get());
}

TEST(SlabClient, ABrokerThatAcceptsNobodyHoldsNobodyUp) {
  const TemporaryDirectory directory;
  const std::string path = directory.address().slab_socket();
  const bus::FileDescriptor listener(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0));
  const auto address = socket_address(path);
  const auto* raw = reinterpret_cast<const sockaddr*>(&address);
  ASSERT_EQ(::bind(listener.get(), raw, sizeof(address)), 0);
  ASSERT_EQ(::listen(listener.get(), 0), 0);
  std::vector<bus::FileDescriptor> waiting;  // until the listener's queue is full
  do {
    waiting.emplace_back(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  } while (::connect(waiting.back().get(), raw, sizeof(address)) == 0);
  ASSERT_EQ(errno, EAGAIN);
  bus::SlabClient client(path);  // once never came back
  EXPECT_FALSE(client.open(1, "", 0ms).has_value());
}

}  // namespace
}  // namespace splatbus::bus_test
