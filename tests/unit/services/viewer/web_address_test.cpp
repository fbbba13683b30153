// Addresses of a gateway, as people send them to each other.
#include "viewer/web_address.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "bus/error.h"

namespace splatbus::viewer {
namespace {

TEST(WebAddress, ThePagesAddressIsTheStreams) {
  const WebAddress full = parse_web_address("https://host.example:7680/some/page?quality=1&token=a#token=b&view=2");
  EXPECT_TRUE(full.tls);
  EXPECT_EQ(full.host, "host.example");
  EXPECT_EQ(full.port, "7680");
  EXPECT_EQ(full.target, "/stream");
  EXPECT_EQ(full.token, "b") << "what is not sent to servers";
  EXPECT_EQ(full.authority(), "host.example:7680");
  EXPECT_EQ(parse_web_address("ws://h/?x=1&token=a").token, "a");
  EXPECT_EQ(parse_web_address("ws://h?token=a#view=1").token, "a");
  EXPECT_EQ(parse_web_address("ws://h#token=").token, "");
  const WebAddress bare = parse_web_address("ws://localhost");
  EXPECT_FALSE(bare.tls);
  EXPECT_EQ(bare.port, "80");
  EXPECT_EQ(bare.token, "");
  EXPECT_EQ(parse_web_address("wss://h").port, "443");
  EXPECT_EQ(parse_web_address("http://h").port, "80");
  const WebAddress v6 = parse_web_address("wss://[::1]:7680/");
  EXPECT_EQ(v6.host, "::1");
  EXPECT_EQ(v6.authority(), "[::1]:7680");
  EXPECT_EQ(parse_web_address("ws://[fe80::2]").port, "80");
}

TEST(WebAddress, WhatIsNoneIsRefusedWithoutItsToken) {
  EXPECT_TRUE(is_web_address("ws://h"));
  EXPECT_FALSE(is_web_address("tcp://h:1"));
  EXPECT_FALSE(is_web_address("ipc:///x/ws://"));
  for (const char* wrong :
       {"ws://", "ws://:80", "wss:///stream", "ws://h:", "ws://h:0", "ws://h:65536", "ws://h:8x", "ws://[::1",
        "ws://[::1]x:80", "ws://[]:80", "ws://user@h:80", "ws://h h", "tcp://h:80", "https://h:x/#token=secret"}) {
    try {
      (void)parse_web_address(wrong);
      ADD_FAILURE() << wrong;
    } catch (const bus::Error& error) {
      EXPECT_THAT(error.what(), testing::Not(testing::HasSubstr("secret")));
    }
  }
}

}  // namespace
}  // namespace splatbus::viewer
