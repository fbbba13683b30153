#include "bus/address.h"

#include <gmock/gmock.h>
#include <stdlib.h>

#include "bus/context.h"
#include "bus/error.h"

namespace splatbus::bus {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

TEST(AddressTest, LocalFolder) {
  const auto address = Address::parse("ipc:///tmp/bus/");
  EXPECT_TRUE(address.is_local());
  EXPECT_EQ(address.publish_endpoint(), "ipc:///tmp/bus/xsub");
  EXPECT_EQ(address.subscribe_endpoint(), "ipc:///tmp/bus/xpub");
  EXPECT_EQ(address.slab_socket(), "/tmp/bus/slabs");
  EXPECT_EQ(address.text(), "ipc:///tmp/bus");
}

TEST(AddressTest, Tcp) {
  const auto address = Address::parse("tcp://example.org:5000");
  EXPECT_FALSE(address.is_local());
  EXPECT_EQ(address.publish_endpoint(), "tcp://example.org:5000");
  EXPECT_EQ(address.subscribe_endpoint(), "tcp://example.org:5001");
  EXPECT_EQ(Address::parse("tcp://[::1]:5000").host, "[::1]");
}

TEST(AddressTest, NonsenseIsRefusedByName) {
  for (const std::string text : {"", "bus", "ipc://", "ipc://relative", "tcp://host", "tcp://:5000", "tcp://host:0",
                                 "tcp://host:65535", "tcp://host:99999999999", "tcp://host:1x", "udp://a:1"}) {
    EXPECT_THAT([&] { (void)Address::parse(text); }, ThrowsMessage<Error>(HasSubstr("'" + text + "'"))) << text;
  }
  EXPECT_THROW((void)Address::parse("ipc:///" + std::string(200, 'a')), Error);
}

TEST(AddressTest, EnvironmentComesFirst) {
  ::setenv("SPLATBUS_BUS", "ipc:///tmp/elsewhere", 1);
  EXPECT_EQ(Address::from_environment().text(), "ipc:///tmp/elsewhere");
  ::unsetenv("SPLATBUS_BUS");
  EXPECT_TRUE(Address::from_environment().is_local());
}

TEST(ContextTest, SourcesNeedNames) {
  const auto address = Address::parse("ipc:///tmp/none");
  for (const std::string& name : {std::string(), std::string("a b"), std::string("a\n"), std::string(65, 'a')}) {
    EXPECT_THROW((void)Context::create(address, name), Error);
  }
}

}  // namespace
}  // namespace splatbus::bus
