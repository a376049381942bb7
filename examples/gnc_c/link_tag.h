/* Tag behind each datagram of the link: the first 16 bytes of HMAC-SHA256 (RFC 2104, FIPS 180-4) with the link's key. */
#ifndef LINK_TAG_H
#define LINK_TAG_H

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { TAG = 16, BLOCK = 64, DIGEST = 32 };

static uint32_t rotated(uint32_t x, int n) { return (x >> n) | (x << (32 - n)); }

/* Digest of at most 4 kB in three parts. */
static void sha256(const uint8_t *const parts[3], const size_t sizes[3], uint8_t digest[DIGEST])
{
    static const uint32_t k[64] = {
        0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5,
        0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174,
        0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da,
        0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967,
        0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
        0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070,
        0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
        0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2};
    uint32_t state[8] = {0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a, 0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
    uint8_t text[4096 + 2 * BLOCK];
    size_t length = 0;

    for (int i = 0; i < 3; i++) {
        memcpy(text + length, parts[i], sizes[i]);
        length += sizes[i];
    }
    const size_t padded = (length + 8) / BLOCK * BLOCK + BLOCK;
    memset(text + length, 0, padded - length);
    text[length] = 0x80;
    for (int i = 0; i < 8; i++)
        text[padded - 1 - i] = (uint8_t)((uint64_t)length * 8 >> 8 * i);
    for (size_t at = 0; at < padded; at += BLOCK) {
        uint32_t w[64], s[8];
        for (int i = 0; i < 16; i++)
            w[i] = (uint32_t)text[at + 4 * i] << 24 | (uint32_t)text[at + 4 * i + 1] << 16
                | (uint32_t)text[at + 4 * i + 2] << 8 | text[at + 4 * i + 3];
        for (int i = 16; i < 64; i++)
            w[i] = w[i - 16] + w[i - 7] + (rotated(w[i - 15], 7) ^ rotated(w[i - 15], 18) ^ w[i - 15] >> 3)
                + (rotated(w[i - 2], 17) ^ rotated(w[i - 2], 19) ^ w[i - 2] >> 10);
        memcpy(s, state, sizeof s);
        for (int i = 0; i < 64; i++) {
            const uint32_t a = s[7] + (rotated(s[4], 6) ^ rotated(s[4], 11) ^ rotated(s[4], 25))
                + ((s[4] & s[5]) ^ (~s[4] & s[6])) + k[i] + w[i];
            const uint32_t b = (rotated(s[0], 2) ^ rotated(s[0], 13) ^ rotated(s[0], 22))
                + ((s[0] & s[1]) ^ (s[0] & s[2]) ^ (s[1] & s[2]));
            memmove(s + 1, s, 7 * sizeof s[0]);
            s[4] += a;
            s[0] = a + b;
        }
        for (int i = 0; i < 8; i++)
            state[i] += s[i];
    }
    for (int i = 0; i < DIGEST; i++)
        digest[i] = (uint8_t)(state[i / 4] >> (24 - 8 * (i % 4)));
}

/* Tag of a datagram for the side of this writer number; 0 in hello, in refused and in the setup. */
static void link_tag(const char *key, uint32_t receiver, const uint8_t *datagram, size_t size, uint8_t tag[TAG])
{
    uint8_t pad[BLOCK] = {0}, inner[DIGEST], outer[DIGEST];
    const size_t length = strlen(key);
    const uint8_t to[4] = {(uint8_t)receiver, (uint8_t)(receiver >> 8), (uint8_t)(receiver >> 16), (uint8_t)(receiver >> 24)};
    const uint8_t *key_part[3] = {(const uint8_t *)key, pad, pad};
    const size_t key_size[3] = {length, 0, 0};

    if (length > BLOCK)
        sha256(key_part, key_size, pad);
    else
        memcpy(pad, key, length);
    for (int i = 0; i < BLOCK; i++)
        pad[i] ^= 0x36;
    const uint8_t *first[3] = {pad, to, datagram};
    const size_t first_size[3] = {BLOCK, sizeof to, size};
    sha256(first, first_size, inner);
    for (int i = 0; i < BLOCK; i++)
        pad[i] ^= 0x36 ^ 0x5c;
    const uint8_t *second[3] = {pad, inner, pad};
    const size_t second_size[3] = {BLOCK, DIGEST, 0};
    sha256(second, second_size, outer);
    memcpy(tag, outer, TAG);
}

/* The key: the first word of HIL_KEY_FILE, by default of the user's own, which hil dss makes; waits for the file. */
static const char *link_key(void)
{
    static char key[4096];
    char path[4096];
    const char *given = getenv("HIL_KEY_FILE"), *base = getenv("XDG_CONFIG_HOME"), *home = getenv("HOME");
    const struct timespec pause = {0, 100000000};

    if (given != NULL)
        snprintf(path, sizeof path, "%s", given);
    else if (base != NULL && *base)
        snprintf(path, sizeof path, "%s/hil/gnc-link.key", base);
    else
        snprintf(path, sizeof path, "%s/.config/hil/gnc-link.key", home != NULL ? home : "");
    for (;; nanosleep(&pause, NULL)) {
        FILE *file = fopen(path, "r");
        if (file == NULL)
            continue;
        const int found = fscanf(file, "%4095s", key);
        fclose(file);
        if (found == 1)
            return key;
    }
}

#endif
