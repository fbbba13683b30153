#include "bus/socket_waits.h"

#include <gtest/gtest.h>
#include <sys/eventfd.h>

#include <thread>

#include "bus/file_descriptor.h"
#include "bus_fixture.h"

namespace splatbus::bus_service {
namespace {

using namespace std::chrono_literals;

/// What readers subscribe to comes to `out`, which is waited for.
class SocketWaitsTest : public testing::Test {
 protected:
  SocketWaitsTest() {
    for (zmq::socket_t* socket : {&out_, &reader_}) socket->set(zmq::sockopt::linger, 0);
    out_.set(zmq::sockopt::xpub_verboser, true);
    out_.bind("ipc://" + directory_.path() + "/out");
    reader_.connect(out_.get(zmq::sockopt::last_endpoint));
    index_ = waits_.add(out_);
  }
  /// Whether waiting is enough to read so many; a wait may end without anything to read.
  [[nodiscard]] bool come(int count, bool all_at_once = true) {
    while (count > 0) {
      waits_.wait(20'000);
      if (!waits_.readable(index_)) return false;
      zmq::message_t message;
      while (out_.recv(message, zmq::recv_flags::dontwait)) {
        --count;
        if (all_at_once) continue;
        waits_.used(index_);
        break;
      }
    }
    return count == 0;
  }

  bus_test::TemporaryDirectory directory_;
  zmq::context_t context_;
  zmq::socket_t out_{context_, zmq::socket_type::xpub}, reader_{context_, zmq::socket_type::sub};
  SocketWaits waits_;
  std::size_t index_ = 0;
};

TEST_F(SocketWaitsTest, SaysWhatComes) {
  for (const char* topic : {"a", "b", "c"}) {
    reader_.set(zmq::sockopt::subscribe, topic);
    EXPECT_TRUE(come(1));
  }
}

TEST_F(SocketWaitsTest, SaysWhatWasHeardMeanwhile) {
  reader_.set(zmq::sockopt::subscribe, "a");
  ASSERT_TRUE(come(1));
  reader_.set(zmq::sockopt::subscribe, "b");
  // Which empties the descriptor, as to send does.
  ASSERT_TRUE(bus_test::eventually([&] { return (out_.get(zmq::sockopt::events) & ZMQ_POLLIN) != 0; }));
  waits_.used(index_);
  EXPECT_TRUE(come(1));
}

TEST_F(SocketWaitsTest, SaysWhatIsLeft) {
  for (const char* topic : {"a", "b", "c"}) reader_.set(zmq::sockopt::subscribe, topic);
  EXPECT_TRUE(come(3, false));
}

TEST(SocketWaits, SaysWhichDescriptorCanBeRead) {
  const bus::FileDescriptor silent(::eventfd(0, EFD_CLOEXEC)), loud(::eventfd(1, EFD_CLOEXEC));
  SocketWaits waits;
  const std::size_t first = waits.add(silent.get()), second = waits.add(loud.get());
  waits.wait(60'000);
  EXPECT_FALSE(waits.readable(first));
  EXPECT_TRUE(waits.readable(second));
}

}  // namespace
}  // namespace splatbus::bus_service
