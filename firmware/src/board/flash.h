/* flash - tables that stay in flash on the AVR and are plain memory on the host. */
#ifndef FLASH_H
#define FLASH_H
#ifdef __AVR__
#include <avr/pgmspace.h>
#define IN_FLASH PROGMEM
#define flash_u32(p) pgm_read_dword(p)
#define flash_u16(p) pgm_read_word(p)
#else
#define IN_FLASH
#define flash_u32(p) (*(p))
#define flash_u16(p) (*(p))
#endif
#endif
