/* 115200 baud from 16 MHz with U2X: 17 * 8 cycles a bit. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>

static inline void uart_begin(void)
{
	UBRR0 = 16;
	UCSR0A = 1 << U2X0;
	UCSR0B = 1 << RXEN0 | 1 << TXEN0;
}

static inline void uart_send(uint8_t byte)
{
	while (!(UCSR0A & 1 << UDRE0))
		;
	UDR0 = byte;
}

static inline uint8_t uart_receive(void)
{
	while (!(UCSR0A & 1 << RXC0))
		;
	return UDR0;
}
