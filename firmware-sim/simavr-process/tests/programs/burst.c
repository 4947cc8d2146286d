/* Sends four bytes as fast as the transmitter takes them, by interrupt. */
#include "uart.h"

static volatile uint8_t sent;

ISR(USART_UDRE_vect)
{
	UDR0 = sent++;
	if (sent == 4)
		UCSR0B &= ~(1 << UDRIE0);
}

int main(void)
{
	uart_begin();
	UCSR0B |= 1 << UDRIE0;
	sei();
	for (;;)
		;
}
